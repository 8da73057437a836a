"""The contents of the plot page: panels of curves, track and lane of a session."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from math import degrees

import numpy as np

from steerd.car_model.path.path import Path as Lane
from steerd.car_model.path.path_spec import parse_path
from steerd.daemon.assembly.session_meta import recorded_path
from steerd.daemon.common.errors import reading
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.info import Recording
from steerd.daemon.sessions.motion import Track, rms
from steerd.daemon.settings.run_options import recorded_options
from steerd.steer_bus import topics
from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.session_read import Session, SessionError
from steerd.steer_bus.topic_columns import Columns
from steerd.steer_bus.topics import Topic
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import read_erpm
from steerd.toml_text import decode_toml, parse_toml

NIS_95 = 7.815  # 95 % of a chi-squared distribution with 3 degrees of freedom lie below
LANE_HALF_WIDTH = 0.30  # where the lateral watchdog stops a car whose file does not say [m]
GAP = 0.5  # a line breaks where samples are further apart [s]


@dataclass(frozen=True)
class Curve:
    """One line of a panel; `role` picks its colour: command, estimate, measured, other, bound."""

    name: str
    role: str
    t: Array
    value: Array


@dataclass(frozen=True)
class Panel:
    """Curves over time that share an axis."""

    title: str
    unit: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Drawing:
    """Everything that is drawn; times in seconds from the session's start."""

    panels: tuple[Panel, ...]  # those for which the session holds data
    track: Track | None  # of the car; None without poses
    e1: Array  # lateral error at the track's times [m], NaN where unknown; empty without a track
    lane: Lane | None  # the path, if the session names one
    half_width: float  # of the lane [m]
    facts: tuple[tuple[str, str], ...]  # label and value of the key figures


def make_curve(name: str, role: str, t: Array, value: Array) -> Iterator[Curve]:
    """A curve with breaks at gaps; none without a finite value."""
    if not np.isfinite(value).any():
        return
    order = np.argsort(t, kind="stable")
    t, value = t[order], value[order]
    broken = np.flatnonzero(np.diff(t) > GAP)
    if len(broken):
        t = np.insert(t, broken + 1, t[broken] + 0.5 * GAP)
        value = np.insert(value, broken + 1, np.nan)
    yield Curve(name, role, t, value)


def make_field_curve(
    s: Recording, topic: Topic, field: str, name: str, role: str, scale: float = 1.0
) -> Iterator[Curve]:
    """A field of a topic as a curve; none without a finite value."""
    table = s.table(topic)
    if table is not None:
        yield from make_curve(name, role, s.times(table), scale * table[field].astype(float))


def make_drawing(read: Recording) -> Drawing:
    """The panels of a session; a SteerdError where it says what makes no sense."""
    with reading(read.info.path):
        track = read.track
        found = [*_list_panels(read)]
        panels = tuple(panel for panel in found if panel.curves)
        e1 = np.empty(0)
        if track is not None:
            e1 = np.full(len(track.t), np.nan)
            for curve in found[0].curves[:1]:
                e1 = np.interp(track.t, curve.t, curve.value / 1e3, np.nan, np.nan)
        lane, width = load_lane(read.session), _half_width(read.session)
        return Drawing(panels, track, e1, lane, width, _figures(read))


def load_lane(session: Session) -> Lane | None:
    """The path of a recorded drive; None if the session does not hold it.

    A path file comes from the session itself, never from this machine's disk.
    """
    options = recorded_options(session.info().metadata)
    if options is None or (options.drill and "closed" not in options.drill):
        return None
    try:
        with recorded_path(session, options.path) as spec:
            return parse_path(spec)
    except (ValueError, SessionError):
        return None


def _half_width(session: Session) -> float:
    """The lateral watchdog's bound in the car file that the session carries [m]."""
    try:
        table = parse_toml(decode_toml(session.attachment("car.toml")))
        return float(table["safety"]["lateral"])
    except (SessionError, ValueError, KeyError, TypeError):
        return LANE_HALF_WIDTH


def _figures(s: Recording) -> tuple[tuple[str, str], ...]:
    facts = []
    if s.track is not None:
        facts.append(("driven", f"{s.track.length:.1f} m"))
    state, tick = s.table(topics.STATE), s.table(topics.TICK)
    if state is not None:
        running = state["mode"] == SupervisorState.RUNNING
        if (e1 := s.lane_errors).size:
            facts.append(("lateral error RMS, after 3 s", f"{1e3 * rms(e1):.1f} mm"))
            facts.append(("largest", f"{1e3 * e1.max():.1f} mm"))
        if running.any():
            facts.append(("fastest", f"{np.nanmax(state['speed'][running]):.2f} m/s"))
    if tick is not None and len(tick["due_ns"]):
        facts.append(("tick late, 99 %", f"{np.quantile(_late_ms(tick), 0.99):.2f} ms"))
    return tuple(facts)


# -- the panels ----------------------------------------------------------------------------------


def _list_panels(s: Recording) -> Iterator[Panel]:
    """Every panel, those without data too; the lateral error comes first."""
    scale, line = degrees(1.0), partial(make_field_curve, s)
    state = partial(line, topics.STATE)
    yield _panel("lateral error e1", "mm", state("e1", "e1", "estimate", 1e3))
    yield _panel("heading error e2", "°", state("e2", "e2", "estimate", scale))
    yield _panel("speed", "m/s", _command(s, "speed"), _wheels(s), _estimate(s, "speed"))
    estimate = state("steer", "estimate", "estimate", scale)
    yield _panel("steering angle (left +)", "°", _command(s, "steer", scale), estimate)
    gyro = line(topics.IMU, "gyro_z", "gyro", "measured", scale)
    yield _panel("yaw rate", "°/s", gyro, _estimate(s, "yaw_rate", scale))
    yield _panel("pose innovation (NIS)", "", _innovation(s))
    yield _panel("mocap minus estimate", "mm", _pose_residual(s))
    yield _panel("control tick", "ms", _timing(s))
    yield _panel("latency", "ms", _latency(s))
    brake = line(topics.ACTUATION, "brake_current_a", "brake commanded", "command")
    yield _panel("current", "A", brake, line(topics.VESC, "current_motor", "motor", "measured"))
    yield from _learnt(s)


def _panel(title: str, unit: str, *curves: Iterable[Curve]) -> Panel:
    return Panel(title, unit, tuple(chain(*curves)))


def _command(s: Recording, field: str, scale: float = 1.0) -> Iterator[Curve]:
    """A field of the commands while the car was driven; imported logs drive throughout."""
    table = s.table(topics.ACTUATION)
    if table is not None:
        driven = table["mode"] == ActuationMode.SPEED
        value = np.where(driven, scale * table[field].astype(float), np.nan)
        yield from make_curve("commanded", "command", s.times(table), value)


def _estimate(s: Recording, field: str, scale: float = 1.0) -> Iterator[Curve]:
    """Speed or yaw rate as estimated, or from the poses where nothing was estimated."""
    curves = tuple(make_field_curve(s, topics.STATE, field, "estimate", "estimate", scale))
    if not curves and s.track is not None:
        value = scale * getattr(s.track, field)
        curves = tuple(make_curve("from poses", "estimate", s.track.t, value))
    yield from curves


def _wheels(s: Recording) -> Iterator[Curve]:
    table = s.table(topics.VESC)
    if table is not None:
        gain, offset = read_erpm(s.session)
        speed = (table["erpm"].astype(float) - offset) / gain
        yield from make_curve("wheels", "measured", s.times(table), speed)
    yield from make_field_curve(s, topics.WHEEL, "speed", "wheels", "measured")


def _innovation(s: Recording) -> Iterator[Curve]:
    for curve in make_field_curve(s, topics.STATE, "nis_pose", "NIS", "estimate"):
        yield curve
        yield Curve("95 % (3 d.o.f.)", "bound", curve.t[[0, -1]], np.full(2, NIS_95))


def _pose_residual(s: Recording) -> Iterator[Curve]:
    """Mocap minus estimate at the same instant, along and across the car."""
    state, track = s.table(topics.STATE), s.track
    if state is None or track is None or not np.isfinite(state["x"]).any():
        return
    good, t = np.isfinite(state["x"]), s.times(state)
    at, x, y = t[good], state["x"][good], state["y"][good]
    dx = track.x - np.interp(track.t, at, x, np.nan, np.nan)
    dy = track.y - np.interp(track.t, at, y, np.nan, np.nan)
    c, n = np.cos(track.yaw), np.sin(track.yaw)
    yield from make_curve("along", "measured", track.t, 1e3 * (dx * c + dy * n))
    yield from make_curve("across", "estimate", track.t, 1e3 * (dy * c - dx * n))


def _timing(s: Recording) -> Iterator[Curve]:
    table = s.table(topics.TICK)
    if table is not None:
        yield from make_curve("late", "command", s.times(table), _late_ms(table))
        yield from make_field_curve(s, topics.TICK, "work_ns", "work", "estimate", 1e-6)


def _late_ms(ticks: Mapping[str, Array]) -> Array:
    """Start of each tick after its deadline; 0 for a tick that came early, with its pose [ms]."""
    past = ticks["woke_ns"].astype(np.int64) - ticks["due_ns"].astype(np.int64)
    return np.maximum(past, 0).astype(np.float64) * 1e-6


def _latency(s: Recording) -> Iterator[Curve]:
    """Delays of poses and replies; none where both are nil, as in virtual time."""
    curves: list[Curve] = []
    for topic, since, until, name, role in (
        (topics.MOCAP, "t_valid_ns", "t_arrival_ns", "pose, from exposure", "estimate"),
        (topics.VESC, "t_sent_ns", "t_received_ns", "VESC, from request", "measured"),
    ):
        table = s.table(topic)
        if table is not None:
            delay = (table[until] - table[since]).astype(float) * 1e-6
            curves += make_curve(name, role, s.times(table), delay)
    yield from curves if any(np.any(c.value) for c in curves) else ()


# -- what the learner reported -------------------------------------------------------------------

BAND = 2.0  # standard deviations to either side: 95 % of a normal distribution
PANELS: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
    ("learnt: gains", "", ("steer_gain", "speed_gain"), 1.0),
    ("learnt: steering bias", "°", ("steer_bias",), degrees(1.0)),
    ("learnt: steering dead time and lag", "ms", ("steer_delay", "steer_lag"), 1e3),
    ("learnt: cornering coefficients", "1/rad", ("c_sf", "c_sr"), 1.0),
)
"""Title, unit, the fields of the message that are drawn, and their scale."""
_ROLES = ("estimate", "measured")


def _learnt(s: Recording) -> Iterator[Panel]:
    """Panels of the learner, if it ran: bands, and the moments of change."""
    table = s.table(topics.MODEL)
    if table is None:
        return
    t = s.times(table)
    for title, unit, fields, scale in PANELS:
        curves: list[Curve] = []
        for field, role in zip(fields, _ROLES, strict=False):
            known = np.isfinite(table[field])
            if known.any():
                at, value = t[known], scale * table[field][known].astype(float)
                width = scale * BAND * table[f"{field}_sd"][known].astype(float)
                ends = (value + width, value - width)
                bounds = [Curve(f"{field}, 95 %", "bound", at, end) for end in ends]
                curves += [Curve(field, role, at, value), *bounds]
        if curves:
            yield Panel(title, unit, (*curves, *_moments(table, t, curves)))


def _moments(table: Columns, t: Array, curves: list[Curve]) -> list[Curve]:
    """An upright line where each change began."""
    since = table["since_ns"].astype(np.int64)
    low = min(float(curve.value.min()) for curve in curves)
    high = max(float(curve.value.max()) for curve in curves)
    lines = []
    for moment in np.unique(since[since >= 0]):
        row = int(np.flatnonzero(since == moment)[-1])
        at = t[row] + 1e-9 * float(moment - int(table["mono_ns"][row]))
        name = str(table["effect"][row]) or str(table["verdict"][row])
        ends = np.array([at, at + 1e-3])
        lines.append(Curve(f"change: {name}", "command", ends, np.array([low, high])))
    return lines
