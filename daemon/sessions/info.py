"""The contents of a session as one value, for `steerd info` and after an import."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from steerd.daemon.common.errors import SteerdError, reading
from steerd.daemon.common.screen import describe_holes
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions import motion
from steerd.daemon.sessions.motion import SignalRange, Track
from steerd.steer_bus import session_read, topics
from steerd.steer_bus.container import SessionInfo, TopicInfo
from steerd.steer_bus.fields import flat_leaves
from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.session_read import Session, SessionError
from steerd.steer_bus.topic_columns import Columns
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Signal
from steerd.vesc_link.scaling import F1TENTH

GAP_FACTOR = 3.0  # a pause of more than this many median intervals is a gap
STATES_MAX = 1000  # state changes kept; a damaged file may hold any number
DISTANCE_MIN = 0.5  # a shorter drive identifies nothing [m]
STEER_SD_MIN = 0.01  # steering that varies less counts as constant [rad]
SPEED_SPAN_MIN = 0.3  # speed that varies less counts as constant [m/s]
LATERAL_ACCEL_MIN = 1.0  # tyre parameters need more lateral acceleration than this [m/s^2]
FAULTS = ("FAULT_STOP", "FAULT_LATCHED", "ESTOP")


@dataclass(frozen=True, slots=True)
class TopicReport:
    """One topic; times in seconds from the session's start."""

    name: str
    type_name: str
    count: int
    rate_hz: float  # by the median interval, so that gaps do not lower it; 0 where there is none
    gaps: int | None  # pauses of more than `GAP_FACTOR` median intervals; None for irregular topics
    longest_gap_s: float  # the longest of them
    longest_gap_at_s: float  # when it began


@dataclass(frozen=True, slots=True)
class StateChange:
    """The supervisor's state from a time on."""

    t_s: float
    state: str
    reason: str


@dataclass(frozen=True, slots=True)
class SessionReport:
    """What `steerd info` shows."""

    info: SessionInfo
    car: str
    mode: str
    topics: tuple[TopicReport, ...]
    empty_topics: tuple[str, ...]
    states: tuple[StateChange, ...]
    end: str  # why the recording ended; empty if it does not say
    length_m: float | None  # path driven; None without poses
    speed: SignalRange | None
    steer: SignalRange | None
    lateral_accel: SignalRange | None
    excitation: tuple[str, ...]  # what cannot be identified from this drive, one sentence each
    warnings: tuple[str, ...]  # what is wrong with the file or implausible in its numbers

    @property
    def stops(self) -> list[str]:
        """Why it was stopped, beginning with the first."""
        return [change.reason for change in self.states if change.state in FAULTS]

    def __repr__(self) -> str:
        return f"<SessionReport of {self.info.path.name}, {len(self.topics)} topics>"


def load_session(path: Path) -> Session:
    """Open a session for a command.

    Raises:
        SteerdError: it cannot be opened, or holds nothing at all.
    """
    with reading(path):
        session = session_read.open_session(path)
    if not session.info().count and not session.info().metadata:
        why = next(iter(session.info().warnings), "no messages")
        raise SteerdError(f"{path} holds no session ({why})")
    return session


@dataclass(frozen=True)
class Recording:
    """A session whose tables were read, in one pass."""

    session: Session  # the file
    tables: dict[str, Columns]  # columns by the topic's name in the file
    problems: Sequence[str]  # what could not be read, as sentences

    @property
    def info(self) -> SessionInfo:
        """What the file says of itself."""
        return self.session.info()

    @cached_property
    def track(self) -> Track | None:
        """The car's track: accepted mocap poses, or the estimate where there are none."""
        poses = self.table(topics.MOCAP)
        if poses is not None and (accepted := poses["reject"] == "").sum() > 2:
            poses = {name: column[accepted] for name, column in poses.items()}
        else:
            poses = self.table(topics.STATE)
        if poses is None:
            return None
        return motion.make_track(self.times(poses), poses["x"], poses["y"], poses["yaw"])

    @cached_property
    def lane_errors(self) -> Array:
        """Sizes of the lateral error as estimated, while driven and settled [m]."""
        state = self.table(topics.STATE)
        return np.empty(0) if state is None else motion.settled_errors(state, self.times(state))

    def table(self, topic: topics.Topic) -> Columns | None:
        """The columns of a topic, whatever the car's name; None where there is none."""
        found = (t for name, t in sorted(self.tables.items()) if topics.find_topic(name) is topic)
        return next(found, None)

    def times(self, table: Columns) -> Array:
        """Stamps of a table, from the session's start [s]."""
        return seconds_since(self.info.start_ns, table["stamp_ns"])

    def signal(self, topic: topics.Topic, name: str) -> Signal | None:
        """A field of a topic, of commands while driven; None where it has no finite value."""
        table = self.table(topic)
        if table is None:
            return None
        t, values = self.times(table), table[name].astype(float)
        if topic is topics.ACTUATION:
            driving = table["mode"] == ActuationMode.SPEED
            t, values = t[driving], values[driving]
        order = np.argsort(t, kind="stable")
        return Signal(t[order], values[order]) if np.isfinite(values).any() else None


def seconds_since(start_ns: int, ns: Any) -> Array:
    """Seconds from a start; subtracting first keeps the nanoseconds."""
    since = ns.astype(np.uint64) - np.uint64(start_ns % (1 << 64))  # damaged times wrap
    return np.asarray(since.astype(np.int64) * 1e-9)


def load_recording(path: Path) -> Recording:
    """Open a session for a command, see `load_session`, and read its tables."""
    return read_recording(load_session(path))


def read_recording(session: Session) -> Recording:
    """Read every topic as columns; what cannot be read, as sentences.

    Raises:
        SteerdError: the file has changed since it was opened.
    """
    wanted: dict[str, type[Any]] = {}
    for info in session.info().topics:
        topic = topics.find_topic(info.name)
        if topic is not None and info.count and flat_leaves(topic.message) is not None:
            wanted[info.name] = topic.message
    tables: dict[str, Columns] = {}
    problems = []
    with reading(session.info().path):
        try:
            tables = session.tables(wanted)
        except SessionError:  # one by one: those that can be read, and why the others cannot
            for name, message in wanted.items():
                try:
                    tables |= session.tables({name: message})
                except SessionError as error:
                    if error.code == "changed":
                        raise
                    problems.append(str(error))
    return Recording(session, tables, problems)


# -- the report ----------------------------------------------------------------------------------


def make_session_report(read: Recording) -> SessionReport:
    """Summarise a session.

    Raises:
        SteerdError: the file has changed since it was opened.
    """
    with reading(read.info.path):
        info, track = read.info, read.track
        steer, wheel = read.signal(topics.ACTUATION, "steer"), read.signal(topics.WHEEL, "speed")
        gyro = read.signal(topics.IMU, "gyro_z")
        about, end = (info.metadata.get(f"steerd.{name}", {}) for name in ("session", "end"))
        cars = sorted({key[0] for topic in info.topics if (key := topics.split_key(topic.name))})
        values = (steer.values if steer else np.empty(0), *_motion(read, wheel, gyro))
        steer_range, speed_range, lateral_range = map(motion.make_range, values)
        doubts: list[str] = []
        if about.get("mode") == "import":  # steerd's own sessions have their car file's figures
            gain = read.session.number("steerd.scaling", "erpm_gain", F1TENTH.erpm_gain)
            doubts = motion.check_erpm(track, read.signal(topics.VESC, "erpm"), gain)
        dropped = describe_holes(end.get("dropped", ""), read.session.holes(), info.start_ns)
        return SessionReport(
            info=info,
            car=about.get("car", ", ".join(cars)),
            mode=about.get("mode", ""),
            topics=tuple(_topic(topic, read) for topic in info.topics if topic.count),
            empty_topics=tuple(topic.name for topic in info.topics if not topic.count),
            states=_states(read),
            end=end.get("reason", ""),
            length_m=track.length if track else None,
            speed=speed_range,
            steer=steer_range,
            lateral_accel=lateral_range,
            excitation=(*_find_unidentifiable(track, speed_range, steer_range, lateral_range),),
            warnings=(
                *info.warnings,
                *filter(None, [dropped]),
                *read.problems,
                *motion.find_implausible(track, steer, wheel, gyro),
                *doubts,
            ),
        )


def _motion(read: Recording, wheel: Signal | None, gyro: Signal | None) -> tuple[Array, Array]:
    """Speed and lateral acceleration, by the estimate, the poses or the wheels."""
    state, track = read.table(topics.STATE), read.track
    if state is not None and np.isfinite(state["speed"]).any():
        return state["speed"], state["speed"] * state["yaw_rate"]
    if track is not None and not (track.coarse and wheel):
        return track.speed, track.lateral_accel
    if wheel is None:
        return np.empty(0), np.empty(0)
    turning = gyro or (track and Signal(track.t, track.yaw_rate))
    rate = np.interp(wheel.t, turning.t, turning.values) if turning else wheel.t * np.nan
    return wheel.values, wheel.values * rate


def _states(read: Recording) -> tuple[StateChange, ...]:
    table = read.table(topics.TRANSITION)
    if table is None:
        return ()
    columns = (seconds_since(read.info.start_ns, table["log_ns"]), table["to_state"], table["text"])
    rows = zip(*(column[:STATES_MAX].tolist() for column in columns), strict=True)
    changes = (StateChange(t, _state_name(after), text) for t, after, text in rows)
    return (StateChange(0.0, _state_name(int(table["from_state"][0])), ""), *changes)


def _state_name(number: int) -> str:
    try:
        return SupervisorState(number).name
    except ValueError:
        return f"state {number}"


def _topic(topic: TopicInfo, read: Recording) -> TopicReport:
    row, table = topics.find_topic(topic.name), read.tables.get(topic.name)
    known = (topic.name, topic.type_name, topic.count)
    irregular = TopicReport(*known, topic.rate_hz, None, 0.0, 0.0)
    if row is None or row.rate_hz <= 0.0 or table is None or topic.count <= 2:
        return irregular
    t = np.sort(read.times(table))
    steps = np.diff(t)
    usual = float(np.median(steps))
    if not (usual > 0.0 and isfinite(usual)):
        return irregular
    gaps, at = int((steps > GAP_FACTOR * usual).sum()), int(np.argmax(steps))
    longest = (float(steps[at]), float(t[at])) if gaps else (0.0, 0.0)
    return TopicReport(*known, 1.0 / usual, gaps, *longest)


def _find_unidentifiable(track: Track | None, *ranges: SignalRange | None) -> Iterator[str]:
    """What cannot be identified from a drive of this speed, steering and lateral acceleration."""
    speed, steer, lateral = ranges
    if track is not None and track.length < DISTANCE_MIN:
        yield "the car barely moved: nothing can be identified"
        return
    if steer is not None and steer.sd < STEER_SD_MIN:
        yield "steering is constant: its gain, delay and lag are not identifiable"
    if speed is not None and speed.high - speed.low < SPEED_SPAN_MIN:
        yield "speed is constant: drive lag and delay are not identifiable"
    if lateral is not None and max(-lateral.low, lateral.high) < LATERAL_ACCEL_MIN:
        limit = f"{LATERAL_ACCEL_MIN:g} m/s²"
        yield f"lateral acceleration stays below {limit}: tyre parameters are not identifiable"
