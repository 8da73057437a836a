"""The contents of a session as one value, for `steerd info` and after an import."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.screen import describe_holes
from steerd.daemon.common.translate import reading
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.motion import (
    Array,
    Signal,
    SignalRange,
    Track,
    check_erpm,
    find_implausible,
    make_range,
    make_track,
)
from steerd.steer_bus.messages import ActuationMode, Transition
from steerd.steer_bus.session import Session, SessionError, SessionInfo, TopicInfo, open_session
from steerd.steer_bus.topic_columns import Columns
from steerd.steer_bus.topics import (
    ACTUATION,
    IMU,
    MOCAP,
    STATE,
    TRANSITION,
    VESC,
    WHEEL,
    Topic,
    find_topic,
    split_key,
)
from steerd.vesc_link.scaling import F1TENTH

GAP_FACTOR = 3.0
"""A pause of more than this many median intervals is a gap."""
STATES_MAX = 1000
"""State changes kept; a damaged file may hold any number."""
DISTANCE_MIN = 0.5
"""A shorter drive identifies nothing [m]."""
STEER_SD_MIN = 0.01
"""Steering that varies less counts as constant [rad]."""
SPEED_SPAN_MIN = 0.3
"""Speed that varies less counts as constant [m/s]."""
LATERAL_ACCEL_MIN = 1.0
"""Tyre parameters need more lateral acceleration than this [m/s^2]."""


@dataclass(frozen=True, slots=True)
class TopicReport:
    """One topic; times in seconds from the session's start.

    Attributes:
        rate_hz: by the median interval, so that gaps do not lower it; 0 where there is none.
        gaps: pauses of more than `GAP_FACTOR` median intervals; None for irregular topics.
        longest_gap_s: the longest of them.
        longest_gap_at_s: when it began.
    """

    name: str
    type_name: str
    count: int
    rate_hz: float
    gaps: int | None
    longest_gap_s: float
    longest_gap_at_s: float


@dataclass(frozen=True, slots=True)
class StateChange:
    """The supervisor's state from a time on."""

    t_s: float
    state: str
    reason: str


@dataclass(frozen=True, slots=True)
class SessionReport:
    """What `steerd info` shows.

    Attributes:
        end: why the recording ended; empty if it does not say.
        length_m: path driven; None without poses.
        excitation: what cannot be identified from this drive, one sentence each.
        warnings: what is wrong with the file or implausible in its numbers.
    """

    info: SessionInfo
    car: str
    mode: str
    topics: tuple[TopicReport, ...]
    empty_topics: tuple[str, ...]
    states: tuple[StateChange, ...]
    end: str
    length_m: float | None
    speed: SignalRange | None
    steer: SignalRange | None
    lateral_accel: SignalRange | None
    excitation: tuple[str, ...]
    warnings: tuple[str, ...]


def load_session(path: Path) -> Session:
    """Open a session for a command.

    Raises:
        SteerdError: it cannot be opened, or holds nothing at all.
    """
    with reading(path):
        session = open_session(path)
    if not session.info().count and not session.info().metadata:
        why = session.warnings[0].message if session.warnings else "no messages"
        raise SteerdError(f"{path} holds no session ({why})", "", ExitCode.INVALID)
    return session


Tables = tuple[dict[str, Columns], list[str]]
"""Columns by topic, and what could not be read, as sentences."""


def make_session_report(session: Session, read: Tables | None = None) -> SessionReport:
    """Read a session once and summarise it.

    Args:
        session: the session.
        read: its tables, where they were read already.

    Raises:
        SteerdError: the file has changed since it was opened.
    """
    with reading(session.info().path):
        return _make_report(session, read or read_tables(session))


def _make_report(session: Session, read: Tables) -> SessionReport:
    info = session.info()
    tables, unreadable = read
    times = Times(info.start_ns)
    track, signals = _motion(tables, times)
    states = _states(session, info.start_ns)
    steer, wheel, gyro, speed, lateral = signals
    about, end = (info.metadata.get(f"steerd.{name}", {}) for name in ("session", "end"))
    cars = sorted({key[0] for topic in info.topics if (key := split_key(topic.name))})
    steer_range, speed_range, lateral_range = map(make_range, (steer.value, speed, lateral))
    return SessionReport(
        info=info,
        car=about.get("car", ", ".join(cars)),
        mode=about.get("mode", ""),
        topics=tuple(_topic(topic, tables, info.start_ns) for topic in info.topics if topic.count),
        empty_topics=tuple(topic.name for topic in info.topics if not topic.count),
        states=states,
        end=end.get("reason", ""),
        length_m=track.length if track else None,
        speed=speed_range,
        steer=steer_range,
        lateral_accel=lateral_range,
        excitation=_find_unidentifiable(track, speed_range, steer_range, lateral_range),
        warnings=(
            *(warning.message for warning in info.warnings),
            *filter(None, [describe_holes(end.get("dropped", ""), session.holes(), info.start_ns)]),
            *unreadable,
            *find_implausible(track, _nonempty(steer), _nonempty(wheel), _nonempty(gyro)),
            *_check_erpm(tables, times, track, session),
        ),
    )


# -- reading -------------------------------------------------------------------------------------


def read_tables(session: Session) -> Tables:
    """Every topic of the table as columns, in one pass; what cannot be read, as sentences."""
    wanted: dict[str, type[Any]] = {}
    for info in session.info().topics:
        topic = find_topic(info.name)
        if topic is not None and info.count and _is_flat(topic):
            wanted[info.name] = topic.message
    try:
        return session.tables(wanted), []
    except SessionError:
        pass
    tables: dict[str, Columns] = {}
    problems = []
    for name, message in wanted.items():
        try:
            tables |= session.tables({name: message})
        except SessionError as error:
            if error.code == "changed":
                raise
            problems.append(str(error))
    return tables, problems


def _is_flat(topic: Topic) -> bool:
    from steerd.steer_bus.fields import flat_leaves

    return flat_leaves(topic.message) is not None


@dataclass(frozen=True, slots=True)
class Times:
    """Seconds since a session's start."""

    start_ns: int

    def of(self, ns: Any) -> Array:
        """Seconds from the start; subtracting first keeps the nanoseconds."""
        since = ns.astype(np.uint64) - np.uint64(self.start_ns % (1 << 64))  # damaged times wrap
        return np.asarray(since.astype(np.int64) * 1e-9)


def find_table(tables: dict[str, Columns], topic: Topic) -> Columns | None:
    """The columns of a topic, whatever the car's name; None where there is none."""
    return next((t for name, t in sorted(tables.items()) if find_topic(name) is topic), None)


def _signal(tables: dict[str, Columns], topic: Topic, name: str, times: Times) -> Signal:
    table = find_table(tables, topic)
    if table is None:
        return Signal(np.empty(0), np.empty(0))
    t, values = times.of(table["stamp_ns"]), table[name].astype(float)
    if topic is ACTUATION:
        driving = table["mode"] == ActuationMode.SPEED
        t, values = t[driving], values[driving]
    order = np.argsort(t, kind="stable")
    return Signal(t[order], values[order])


def _nonempty(signal: Signal) -> Signal | None:
    return signal if np.isfinite(signal.value).any() else None


def _check_erpm(
    tables: dict[str, Columns], times: Times, track: Track | None, session: Session
) -> list[str]:
    """Doubts about the ERPM of another system's log; steerd's own have their car file's figures."""
    if session.info().metadata.get("steerd.session", {}).get("mode") != "import":
        return []
    erpm = _signal(tables, VESC, "erpm", times)
    gain = session.number("steerd.scaling", "erpm_gain", F1TENTH.erpm_gain)
    return check_erpm(track, _nonempty(erpm), gain)


def _motion(
    tables: dict[str, Columns], times: Times
) -> tuple[Track | None, tuple[Signal, Signal, Signal, Array, Array]]:
    """The track, and steering, wheel speed, gyro, speed, lateral acceleration."""
    track = make_track_of(tables, times)
    steer, wheel, gyro = (
        _signal(tables, topic, name, times)
        for topic, name in ((ACTUATION, "steer"), (WHEEL, "speed"), (IMU, "gyro_z"))
    )
    state = find_table(tables, STATE)
    if state is not None and np.isfinite(state["speed"]).any():
        return track, (steer, wheel, gyro, state["speed"], state["speed"] * state["yaw_rate"])
    if track is not None and not (track.coarse and _nonempty(wheel)):
        return track, (steer, wheel, gyro, track.speed, track.lateral_accel)
    turning = gyro if _nonempty(gyro) or track is None else Signal(track.t, track.yaw_rate)
    rate = np.interp(wheel.t, turning.t, turning.value) if turning.t.size else wheel.t * np.nan
    return track, (steer, wheel, gyro, wheel.value, wheel.value * rate)


def make_track_of(tables: dict[str, Columns], times: Times) -> Track | None:
    """The car's track: accepted mocap poses, or the estimate where there are none."""
    poses = find_table(tables, MOCAP)
    if poses is not None and (accepted := poses["reject"] == "").sum() > 2:
        poses = {name: column[accepted] for name, column in poses.items()}
    else:
        poses = find_table(tables, STATE)
    if poses is None:
        return None
    return make_track(times.of(poses["stamp_ns"]), poses["x"], poses["y"], poses["yaw"])


def _states(session: Session, start_ns: int) -> tuple[StateChange, ...]:
    names = {t.name for t in session.info().topics if find_topic(t.name) is TRANSITION and t.count}
    changes: list[StateChange] = []
    for record in session.messages(*names) if names else ():
        try:
            message = record.decode()
        except ValueError:
            continue
        if isinstance(message, Transition) and len(changes) < STATES_MAX:
            t_s = (record.log_ns - start_ns) * 1e-9
            if not changes:
                changes.append(StateChange(0.0, _state_name(message.from_state), ""))
            changes.append(StateChange(t_s, _state_name(message.to_state), message.text))
    return tuple(changes)


def _state_name(number: int) -> str:
    try:
        return SupervisorState(number).name
    except ValueError:
        return f"state {number}"


# -- summary -------------------------------------------------------------------------------------


def _topic(topic: TopicInfo, tables: dict[str, Columns], start_ns: int) -> TopicReport:
    row = find_topic(topic.name)
    table = tables.get(topic.name)
    regular = row is not None and row.rate_hz > 0.0 and table is not None and topic.count > 2
    if not regular or table is None:
        return TopicReport(topic.name, topic.type_name, topic.count, topic.rate_hz, None, 0.0, 0.0)
    t = np.sort(Times(start_ns).of(table["stamp_ns"]))
    steps = np.diff(t)
    usual = float(np.median(steps))
    if not (usual > 0.0 and isfinite(usual)):
        return TopicReport(topic.name, topic.type_name, topic.count, topic.rate_hz, None, 0.0, 0.0)
    long = steps > GAP_FACTOR * usual
    at = int(np.argmax(steps))
    longest = float(steps[at]) if long.any() else 0.0
    return TopicReport(
        topic.name,
        topic.type_name,
        topic.count,
        1.0 / usual,
        int(long.sum()),
        longest,
        float(t[at]) if long.any() else 0.0,
    )


def _find_unidentifiable(
    track: Track | None,
    speed: SignalRange | None,
    steer: SignalRange | None,
    lateral: SignalRange | None,
) -> tuple[str, ...]:
    """What cannot be identified from this drive."""
    remarks = []
    if track is not None and track.length < DISTANCE_MIN:
        return ("the car barely moved: nothing can be identified",)
    if steer is not None and steer.sd < STEER_SD_MIN:
        remarks.append("steering is constant: its gain, delay and lag are not identifiable")
    if speed is not None and speed.high - speed.low < SPEED_SPAN_MIN:
        remarks.append("speed is constant: drive lag and delay are not identifiable")
    if lateral is not None and max(-lateral.low, lateral.high) < LATERAL_ACCEL_MIN:
        limit = f"{LATERAL_ACCEL_MIN:g} m/s²"
        remarks.append(
            f"lateral acceleration stays below {limit}: tyre parameters are not identifiable"
        )
    return tuple(remarks)
