"""A ROS 1 or ROS 2 bag as a session, read by rosbags (optional, imported only here).

A bag's own message definitions are used; bags that carry none (rosbag2's older SQLite files) are
read with ROS's standard ones and those of `ackermann_msgs`, `vesc_msgs` and `phasespace_msgs`.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import Advance
from steerd.daemon.imports.import_map import ImportMap
from steerd.daemon.imports.import_session import ImportReport, MessageMaker, Sample, write_import
from steerd.steer_bus import standard
from steerd.steer_bus.atomic_file import is_full
from steerd.steer_bus.fields import schema_text, type_name
from steerd.steer_bus.standard import AckermannDriveStamped, Odometry, PoseStamped, VescStateStamped
from steerd.steer_bus.topics import ACTUATION, MOCAP, VESC, WHEEL, Topic

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

RIGIDS = "phasespace_msgs/msg/Rigids"
RIGIDS_TEXT = Path(__file__).with_name("Rigids.msg").read_text(encoding="utf-8")
"""The ROS 2 form; ROS 1's has no heading_y, and its bags carry their definitions."""
_ODOMETRY = type_name(Odometry)


class Role(NamedTuple):
    """What a topic of a bag can be."""

    topic: Topic  # of the session
    types: tuple[str, ...]  # of the bag's messages
    # Names of F1TENTH's topics, best first: what a mocap node sends before what the car thinks, and
    # what goes to the VESC before what somebody asked for; without any it must be chosen
    preferred: tuple[str, ...] = ()
    lacking: str = ""  # what cannot be computed without it


BAG_ROLES: Mapping[str, Role] = {
    "pose": Role(
        MOCAP, (type_name(PoseStamped), _ODOMETRY, RIGIDS),
        (r"vrpn|mocap|motion_?capture|vicon|optitrack|natnet|qualisys|phasespace|ground_?truth",
         r"(^|/)pf/|particle|amcl|slam", r"odom"),
        "identify and diagnose need the car's track",
    ),
    "command": Role(
        ACTUATION, (type_name(AckermannDriveStamped),),
        (r"ackermann_cmd$|ackermann_cmd_mux/output$", r"(^|/)drive$", r"teleop|joy"),
        "identify and diagnose need the commands to the car",
    ),
    "vesc": Role(
        VESC, (type_name(VescStateStamped),), (r"sensors/core$",),
        "the wheels' speed is not known; wheel=TOPIC takes it from an Odometry",
    ),
    "wheel": Role(WHEEL, (_ODOMETRY,)),
}  # fmt: skip
_OTHER_CLOCK_NS = 10_000_000_000  # header stamps this far from the bag's time are of another clock
_ADVANCE_MESSAGES = 1000  # messages between two reports of progress
_SHOWN = 8  # topics that an error lists


def import_bag(
    source: Path, the_map: ImportMap, out: Path, advance: Advance, named: Sequence[str] = ()
) -> ImportReport:
    """Turn a bag into a session.

    Args:
        source: a ROS 1 `.bag`, a ROS 2 bag folder, or one `.mcap` or `.db3` file of one.
        the_map: one with `[topics]`, `[frame]` or `[session]`, or an empty one.
        out: the session to write; nothing is left of it after an error.
        advance: called with the share of the bag's time read so far, 0 to 1.
        named: `TOPIC`, or `ROLE=TOPIC` with one of `BAG_ROLES`; they override the map's.

    Raises:
        SteerdError: rosbags is missing, or something is wrong with bag, map or output.
    """
    with closing(_open(source)) as reader:
        epoch_ns = max(reader.start_time, 0) if reader.message_count else 0
        the_map = replace(the_map, epoch_ns=epoch_ns)
        types = _types_of(reader)
        roles = _choose_topics(source, types, the_map.topics, named)
        bag = _Bag(source, reader, roles, the_map)
        topics = [BAG_ROLES[role].topic for role in roles]
        made = write_import(out, source, the_map, topics, bag.samples(advance), bag.notes)
    return replace(made, remarks=tuple(_remarks(roles, types)))


def _types_of(reader: "AnyReader") -> dict[str, str]:
    """Type by topic, of topics with messages."""
    return {c.topic: c.msgtype for c in reader.connections if c.msgcount}


def _remarks(roles: Mapping[str, str], types: Mapping[str, str]) -> Iterator[str]:
    """What was chosen among several, and what is missing for an identification."""
    for role, topic in roles.items():
        others = [t for t in _find_topics(types, role) if t != topic]
        if others and role != "wheel":
            more = f" and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
            yield f"{role} is {topic}, not {', '.join(others[:_SHOWN])}{more} (--topic chooses)"
    for role, about in BAG_ROLES.items():
        if about.lacking and role not in roles and not (role == "vesc" and "wheel" in roles):
            wanted = " or ".join(kind.rpartition("/")[2] for kind in about.types)
            yield f"no {role}: {about.lacking} (a topic of {wanted})"


def propose_bag(source: Path) -> dict[str, dict[str, Any]]:
    """Roles and topics of a bag, the first of several where names do not decide.

    Raises:
        SteerdError: it cannot be read, or holds no topic that steerd reads.
    """
    with closing(_open(source)) as reader:
        types = _types_of(reader)
    best = {role: found[0] for role, found in find_best(types).items()}
    return {"topics": _expect_any(source, types, best)}


def _open(source: Path) -> "AnyReader":
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        what, hint = "reading ROS bags needs the package rosbags", "pip install rosbags"
        raise UsageError(what, hint) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    texts = {type_name(c): schema_text(c) for c in (AckermannDriveStamped, VescStateStamped)}
    for name, text in (texts | {RIGIDS: RIGIDS_TEXT}).items():
        types = get_types_from_msg(text, name)
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})

    with _reading(source):
        reader = AnyReader([source], default_typestore=store)
        reader.open()
        return reader


@contextmanager
def _reading(source: Path) -> Iterator[None]:
    """Call rosbags, whose readers raise errors of any type on a damaged file."""
    try:
        yield
    except Exception as error:
        if isinstance(error, OSError) and is_full(error):
            raise  # a compressed bag is unpacked into a temporary folder: the bag itself is good
        text = " ".join(str(error).split())[:160] or type(error).__name__
        what = f"{source} cannot be read as a ROS bag: {text}"
        hint = "name a .bag file, a ROS 2 bag folder or its .mcap file"
        raise SteerdError(what, hint, ExitCode.UNREADABLE) from error


# -- roles of topics -----------------------------------------------------------------------------


def _choose_topics(
    source: Path, types: Mapping[str, str], mapped: Mapping[str, str], named: Iterable[str]
) -> dict[str, str]:
    """Role to topic: as named, else as mapped, else the only topic of a fitting type."""
    chosen = dict(mapped)
    for text in named:
        role, equals, topic = text.rpartition("=")
        fits = (r for r, about in BAG_ROLES.items() if types.get(topic) in about.types)
        chosen[role if equals else next(fits, "pose")] = topic
    for role, topic in chosen.items():
        if role not in BAG_ROLES:
            raise UsageError(f"--topic {role}={topic}: {role!r} is none of {', '.join(BAG_ROLES)}")
        if topic not in types:
            raise SteerdError(f"{source.name} has no messages on {topic}", _list_topics(types))
        if types[topic] not in BAG_ROLES[role].types:
            what = f"{source.name}: {topic} is a {types[topic]}, which steerd cannot use"
            raise SteerdError(what)
    best = {role: found for role, found in find_best(types).items() if role not in chosen}
    several = [
        f"{role}: " + ", ".join(f"{t} ({types[t].rpartition('/')[2]})" for t in found[:_SHOWN])
        for role, found in best.items()
        if len(found) > 1
    ]
    if several:
        what = f"{source.name} has several topics for {'; '.join(several)}"
        raise UsageError(what, "choose each with --topic TOPIC")
    return _expect_any(source, types, chosen | {role: found[0] for role, found in best.items()})


def _find_topics(types: Mapping[str, str], role: str) -> list[str]:
    return [topic for topic, kind in sorted(types.items()) if kind in BAG_ROLES[role].types]


def find_best(types: Mapping[str, str]) -> dict[str, list[str]]:
    """The topics whose names fit each role best: one where F1TENTH's own names decide."""
    best = {}
    for role, about in BAG_ROLES.items():
        topics = _find_topics(types, role)
        if about.preferred and topics:
            names = (re.compile(pattern, re.IGNORECASE) for pattern in about.preferred)
            fits = ([topic for topic in topics if name.search(topic)] for name in names)
            best[role] = next(filter(None, fits), topics)
    return best


def _expect_any(source: Path, types: Mapping[str, str], roles: dict[str, str]) -> dict[str, str]:
    """The roles; a bag without a drive is refused, with what a drive is made of."""
    if roles:
        return roles
    kinds = dict.fromkeys(
        kind.rpartition("/")[2] for role in BAG_ROLES.values() for kind in role.types
    )
    hint = f"steerd reads {', '.join(kinds)}; {_list_topics(types)}"
    raise SteerdError(f"{source.name} has no topic of a type that steerd reads", hint)


def _list_topics(types: Mapping[str, str]) -> str:
    listed = ", ".join(f"{t} ({k})" for t, k in sorted(types.items())[:_SHOWN])
    return f"it has {listed or 'nothing'}"


# -- messages ------------------------------------------------------------------------------------


class _Bag:
    """An open bag and the roles of its topics; `notes` counts what is odd while samples come."""

    def __init__(
        self, source: Path, reader: "AnyReader", roles: Mapping[str, str], the_map: ImportMap
    ) -> None:
        self.notes: Counter[str] = Counter()
        self._source, self._reader, self._roles, self._map = source, reader, roles, the_map
        self._maker = MessageMaker(the_map.epoch_ns, the_map.frame)

    def samples(self, advance: Advance) -> Iterator[Sample]:
        """The samples of the topics that have a role."""
        start_ns = self._map.epoch_ns
        span_ns = max(self._reader.end_time - start_ns, 1)
        other_clock: dict[str, bool] = {}
        for count, (topic, bag_ns, message) in enumerate(self._records()):
            if count % _ADVANCE_MESSAGES == 0:
                advance((bag_ns - start_ns) / span_ns)
            stamp_ns = standard.stamp_ns(message.header)
            if topic not in other_clock:
                other_clock[topic] = abs(stamp_ns - bag_ns) > _OTHER_CLOCK_NS
                if other_clock[topic]:
                    self.notes[f"topic has stamps of another clock, not used: {topic}"] += 1
            log_ns = bag_ns - start_ns
            t_ns = log_ns if other_clock[topic] else stamp_ns - start_ns
            for role in (role for role, wanted in self._roles.items() if wanted == topic):
                made = self._make_message(role, message, t_ns, log_ns)
                if made is not None:
                    yield Sample(BAG_ROLES[role].topic, t_ns, log_ns, made)

    def _records(self) -> Iterator[tuple[str, int, Any]]:
        """Topic, time and message of each record of the chosen topics."""
        wanted = [c for c in self._reader.connections if c.topic in self._roles.values()]
        records = self._reader.messages(wanted)
        while True:
            with _reading(self._source):
                record = next(records, None)
                if record is None:
                    return
                connection, bag_ns, data = record
                message = self._reader.deserialize(data, connection.msgtype)
            yield connection.topic, bag_ns, message

    def _make_message(self, role: str, message: Any, t_ns: int, log_ns: int) -> Any:
        maker = self._maker
        try:
            if role == "command":
                drive = message.drive
                return maker.command(t_ns, float(drive.steering_angle), float(drive.speed))
            if role == "vesc":
                return _telemetry(message.state, t_ns, maker)
            if role == "wheel":
                return maker.wheel(t_ns, float(message.twist.twist.linear.x))
            pose = self._pose(message)
            return pose and maker.pose(t_ns, log_ns, *pose)
        except ValueError:
            self.notes[f"{role} messages hold no finite values and were left out"] += 1
            return None

    def _pose(self, message: Any) -> Any:
        """Position and quaternion (w, x, y, z) of a PoseStamped, an Odometry or a Rigids."""
        if not hasattr(message, "rigids"):
            pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            p, q = pose.position, pose.orientation
            return (p.x, p.y, p.z), (q.w, q.x, q.y, q.z)
        bodies, rigid = {int(body.id): body for body in reversed(message.rigids)}, self._map.rigid
        if rigid is None and len(bodies) > 1:
            ids = sorted(bodies)
            what = f"the PhaseSpace messages hold rigid bodies {', '.join(map(str, ids))}"
            raise UsageError(what, f"name the car with --rigid, e.g. --rigid {ids[0]}")
        body = next(iter(bodies.values()), None) if rigid is None else bodies.get(rigid)
        if body is None:
            return None
        if body.cond <= 0:  # PhaseSpace: the body was not found in this frame
            self.notes["frames without the rigid body were left out"] += 1
            return None
        return (body.x, body.y, body.z), (body.qw, body.qx, body.qy, body.qz)


def _telemetry(state: Any, t_ns: int, maker: MessageMaker) -> Any:
    """VescState in its ROS 2 or its ROS 1 layout; `speed` is electrical rpm in both."""
    names = (
        "voltage_input", "current_motor", "current_input", "duty_cycle", "temp_fet", "temp_motor",
        "avg_id", "avg_iq", "avg_vd", "avg_vq",
    )  # fmt: skip
    ros1 = {"temp_fet": getattr(state, "temperature_pcb", nan)}
    values = tuple(float(getattr(state, name, ros1.get(name, nan))) for name in names)
    return maker.telemetry(t_ns, float(state.speed), values)
