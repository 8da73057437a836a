"""What every mocap source gives: poses, and its own state.

The state machine (`step_monitor`) goes CONNECTING -> SYNCING -> OK -> STALE -> LOST. Liveness is
good frames, never the socket: a silent server keeps its TCP connection for minutes.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import nan

from steerd.steer_bus.quick_values import quick_value


class ClockKind(StrEnum):
    """How a pose's time of validity was found."""

    ECHO = "echo"  # two-way exchange with the server's clock
    HULL = "hull"  # one-way: lower hull of arrival minus source time
    ARRIVAL = "arrival"  # time of arrival minus the configured latency


@quick_value
class Pose:
    """One body in one frame: as the source sent it, then timed, placed and judged (`PoseIngest`).

    What was sent keeps vendor axes, vendor units and the source's ticks, for the session file.
    """

    body: str  # name of the body
    frame: int | None  # the source's frame or sequence number; None where it has none
    # Mid-exposure (or sample) time on the source's clock; None if not sent
    source_ticks: int | None
    transmit_ticks: int | None  # time of sending on the same clock; None if not sent
    t_arrival_ns: int  # when the host received it, CLOCK_MONOTONIC
    position: tuple[float, float, float]  # (x, y, z)
    quaternion: tuple[float, float, float, float]  # (w, x, y, z)
    # The server's marker residual in its length unit; None if not sent
    mean_error: float | None = None
    tracking_valid: bool = True  # the server's own verdict
    live: bool = True  # False while the server replays a recording
    t_valid_ns: int = 0  # when the car was there, on the same clock; never after `t_arrival_ns`
    clock: ClockKind = ClockKind.ARRIVAL  # how `t_valid_ns` was found
    x: float = nan  # CoG in the world frame [m]; NaN until it is placed, and where it has no place
    y: float = nan
    yaw: float = nan  # heading, counter-clockwise [rad], in (-pi, pi]
    height: float = nan  # the mocap body's height [m]
    tilt: float = nan  # angle between the body's up axis and the world's [rad]
    # None, or the reason (see `gates.REASONS`) why it must not be fused
    rejected: str | None = None


class SourceState(StrEnum):
    """State of a mocap source."""

    CONNECTING = "connecting"
    SYNCING = "syncing"
    OK = "ok"
    STALE = "stale"
    LOST = "lost"


PERIOD_NS = 10_000_000
"""Time between two frames, until a server names its own rate."""
STALE_FRAMES = 3
"""Missed frames after which a source is STALE."""
LOST_NS = 150_000_000
"""Silence after which it is LOST; 2 m/s x 0.15 s = 30 cm blind."""
RECOVER_FRAMES = 10
"""Good frames in a row before OK, at the start and after LOST."""


@quick_value
class MonitorState:
    """Where the machine is, the last good frame's arrival, and good frames in a row."""

    state: SourceState = SourceState.CONNECTING
    last_good_ns: int | None = None
    good_run: int = 0


def step_monitor(
    s: MonitorState,
    t_ns: int,
    *,
    connected: bool,
    clock_ready: bool,
    good: bool | None = None,
    period_ns: int = PERIOD_NS,
) -> MonitorState:
    """Advance the machine by one frame (`t_ns`: its arrival) or by time (`t_ns`: now).

    A single good frame ends STALE (its poses are fused anyway); LOST asks for `RECOVER_FRAMES`
    good frames in a row and a ready clock, as the first OK does. `connected`: the session with the
    server stands; `clock_ready`: source times can be mapped; `good`: the frame passed the gates or
    failed them, None for no frame.
    """
    last_ns, run = s.last_good_ns, s.good_run
    if good:
        gap = last_ns is not None and t_ns - last_ns > LOST_NS
        last_ns, run = t_ns, 1 if gap else run + 1
    elif good is not None:
        run = 0
    age = None if last_ns is None else t_ns - last_ns
    fresh = age is not None and age <= STALE_FRAMES * period_ns
    ready = fresh and clock_ready and run >= RECOVER_FRAMES
    lost = age is None or age > LOST_NS
    state = _next_state(s.state, connected=connected, ready=ready, fresh=fresh, lost=lost)
    if good is None and state is s.state:
        return s
    return MonitorState(state, last_ns, run)


def _next_state(
    state: SourceState, *, connected: bool, ready: bool, fresh: bool, lost: bool
) -> SourceState:
    match state:
        case SourceState.CONNECTING:
            return SourceState.SYNCING if connected else state
        case SourceState.SYNCING if not ready:
            return state if connected else SourceState.CONNECTING
        case SourceState.SYNCING | SourceState.LOST:
            return SourceState.OK if ready else state
    if lost:
        return SourceState.LOST
    return SourceState.OK if fresh else SourceState.STALE


@dataclass(frozen=True, slots=True)
class SourceStatus:
    """A source's health for the supervisor, the log and the terminal."""

    state: SourceState  # the state machine's state
    detail: str = ""  # the latest event to report
    server: str = ""  # the server's name and version, as far as known
    bodies: tuple[str, ...] = ()  # names of the bodies that the server offers, as far as known
    clock: ClockKind | None = None  # how the last sample was timed; None before the first
    clock_sigma_ns: int | None = None  # one-sigma bound of the clock map, None where there is none
    rate_hz: float = 0.0  # measured frame rate over the last second
    expected_rate_hz: float | None = None  # the server's own figure, None if not received
    refused: bool = False  # the source cannot be used as configured (`detail` says why)
