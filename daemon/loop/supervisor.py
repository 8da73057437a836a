"""Who may move the car, and how it stops: one pure function over the table in ``transitions``.

``step`` turns what is true now (``Conditions``) and what was asked for (``Request``) into guard
bits, takes the first row that matches, and says what the motor bytes and the steering must be. The
invariants I1-I8 of `docs/reference/safety-requirements.md#invariants` are enumerated over it in the
tests. No clock, no I/O, no randomness.
"""

from math import inf, isfinite
from typing import NamedTuple

from steerd.daemon.loop.transitions import STOP_REASON, Is, Motor, Row, State, Steering, choose

STILL_SPEED = 0.05  # [m/s] slower than this is standing
SOFT_DECEL = 1.5  # [m/s2] slope of the speed cap while stopping
SOFT_BRAKE_SPEED = 0.3  # [m/s] below it a VESC's speed loop lets go, so brake current takes over
LAUNCH_SPEED = 0.5  # [m/s] until the launch checks have passed
OPEN_FRAMES = 3  # brake frames after the port was (re)opened
STILL_NS = 300_000_000
GREEN_NS = 1_000_000_000
PROOF_NS = 210_000_000  # longer than the 200 ms between the ALIVEs of a forgotten VESC Tool
PROOF_SLACK_NS = 50_000_000
CENTRE_NS = 500_000_000  # full lock to centre takes 0.1 s; the rest is for lost frames
GAP_NS = 100_000_000  # nobody looked for so long: what held before proves nothing
NEVER = -1
DURATIONS = {
    State.ARMED: 30 * 10**9,
    State.STOPPING: 4 * 10**9,
    State.FAULT_STOP: 2 * 10**9,
    State.ESTOP: 2 * 10**9,
}


class Conditions(NamedTuple):
    """What is true in this tick.

    Attributes:
        facts: the first twelve bits of ``Is``.
        speed: best known speed [m/s]; NaN when no source tells it.
        timeout_ns: the VESC's own timeout as read from its appconf.
        text: the worst watchdog trip in words, for the log and for people.
    """

    facts: int
    speed: float
    timeout_ns: int
    text: str = ""


class SupervisorState(NamedTuple):
    """All that the supervisor remembers; times are [ns], monotonic."""

    state: State
    t_ns: int
    since_ns: int
    reason: str
    still_ns: int
    """Seen standing since, or ``NEVER``; likewise ``green_ns`` and ``proof_ns``."""
    green_ns: int
    proof_ns: int
    cap: float
    rearm: bool
    braking: bool
    frames: int


class Action(NamedTuple):
    """What this tick must put on the wire, and why, in words.

    Attributes:
        motor: kind of motor bytes.
        steering: kind of servo bytes.
        cap: highest speed that may be ordered [m/s]; ``inf`` where the gate's own limit rules.
        reason: why the supervisor is in this state.
        waiting: what it waits for.
    """

    motor: Motor
    steering: Steering
    cap: float
    reason: str
    waiting: str


_GIVEN = (1 << 12) - 1
_REQUESTS = (1 << 9) - 1
_KNOWN = (1 << 10) - 1
_SHIFT = 18
(
    _LINKED, _IDENTIFIED, _GREEN, _FW_TIMEOUT, _LEASED, _SOFT, _HARD, _KILLED, _ENDED, _LAUNCHED,
    _ESTIMATED, _SLOWING, _GREEN_HELD, _STILL, _MEASURED, _PROVEN, _ELAPSED, _REARM,
) = (1 << bit for bit in range(_SHIFT))  # fmt: skip
_UNKNOWN = int(Is.UNKNOWN)
_SPOILS_REARM = int(Is.SOFT | Is.DISARM | Is.UNKNOWN)


def make_supervisor_state(t_ns: int) -> SupervisorState:
    """Return the state of a process that has just started: INIT, nothing proven."""
    return SupervisorState(
        State.INIT, t_ns, t_ns, "started", NEVER, NEVER, NEVER, 0.0, False, False, OPEN_FRAMES
    )


def _since(holds: object, began: int, t_ns: int) -> int:
    """When a condition was first seen to hold, ``NEVER`` while it does not."""
    if not holds:
        return NEVER
    return t_ns if began == NEVER else began


def _renew_timers(s: SupervisorState, c: Conditions, t_ns: int) -> tuple[int, int, int]:
    """Return since when the car stands, the checks are green, the timeout shows."""
    if not 0 <= t_ns - s.t_ns <= GAP_NS:
        return NEVER, NEVER, NEVER
    still = -STILL_SPEED < c.speed < STILL_SPEED
    proof = c.facts & _FW_TIMEOUT and s.state == State.SELF_TEST
    return (
        _since(still, s.still_ns, t_ns),
        _since(c.facts & _GREEN, s.green_ns, t_ns),
        _since(proof, s.proof_ns, t_ns),
    )


def _held(began: int, t_ns: int, duration_ns: int) -> bool:
    return began != NEVER and t_ns - began >= duration_ns


def derive(s: SupervisorState, c: Conditions, requests: int, t_ns: int) -> int:
    """Return all guard bits (``Is``); the timers in ``s`` must be those of this tick."""
    asked = int(requests)
    bits = (int(c.facts) & _GIVEN) | (asked & _REQUESTS) << _SHIFT
    if asked & ~_KNOWN:
        bits |= _UNKNOWN
    if _held(s.green_ns, t_ns, GREEN_NS):
        bits |= _GREEN_HELD
    if _held(s.still_ns, t_ns, STILL_NS):
        bits |= _STILL
    if isfinite(c.speed):
        bits |= _MEASURED
    if _held(s.proof_ns, t_ns, PROOF_NS):
        bits |= _PROVEN
    allowed = (
        c.timeout_ns + PROOF_SLACK_NS if s.state == State.SELF_TEST else DURATIONS.get(s.state)
    )
    if allowed is not None and t_ns - s.since_ns >= allowed:
        bits |= _ELAPSED
    if s.state == State.INIT and s.frames:
        bits &= ~_IDENTIFIED
    if s.rearm and not bits & _SPOILS_REARM and bits & _LEASED:
        bits |= _REARM
    return bits


def _enter(s: SupervisorState, row: Row, c: Conditions, t_ns: int) -> SupervisorState:
    own_words = s.reason if row.to == State.FAULT_LATCHED else c.text
    reason = row.reason or own_words or "a watchdog tripped"
    frames = OPEN_FRAMES if row.to == State.INIT else s.frames
    rearm = row.reason == STOP_REASON
    return SupervisorState(
        row.to, t_ns, t_ns, reason, s.still_ns, NEVER, NEVER, s.cap, rearm, False, frames
    )


def _next_cap(s: SupervisorState, old: SupervisorState, bits: int, speed: float) -> float:
    """Speed cap [m/s]: it only ever falls while stopping, starting at what the car really does."""
    if s.state == State.RUNNING:
        # What shows as launched when a drive begins is the drive before.
        launched = old.state == State.RUNNING and bits & _LAUNCHED
        return inf if launched else LAUNCH_SPEED
    if s.state != State.STOPPING:
        return 0.0
    if old.state != State.STOPPING:
        return min(old.cap, abs(speed)) if bits & _MEASURED else 0.0
    return max(0.0, old.cap - SOFT_DECEL * max(0, s.t_ns - old.t_ns) * 1e-9)


def _choose_motor(s: SupervisorState, old: SupervisorState, bits: int) -> Motor:
    """Motor bytes that follow from the state; `docs/reference/safety-requirements.md#s3.1`."""
    match s.state:
        case State.INIT:
            return Motor.SOFT_BRAKE if s.frames and bits & _LINKED else Motor.SILENT
        case State.ARMED:
            return Motor.HOLD_BRAKE
        case State.RUNNING:
            return Motor.DRIVE
        case State.STOPPING:
            return Motor.SOFT_BRAKE if s.braking else Motor.RAMP_STOP
        case State.FAULT_STOP:
            return Motor.BRAKE if bits & _SLOWING else Motor.DUTY_ZERO
        case State.FAULT_LATCHED:
            return Motor.RELEASE_ONCE if old.state != State.FAULT_LATCHED else Motor.SILENT
        case State.ESTOP if not (bits & _ELAPSED and bits & _STILL):
            return Motor.ESTOP_BRAKE if bits & _SLOWING else Motor.DUTY_ZERO
        case _:
            return Motor.SILENT


def _choose_steering(s: SupervisorState, bits: int, motor: Motor) -> Steering:
    """Servo bytes that follow from the state; `docs/reference/safety-requirements.md#s3.1`."""
    match s.state:
        case State.ARMED:
            return Steering.CENTRE
        case State.RUNNING | State.STOPPING:
            return Steering.LIVE
        case State.DISARMED | State.FAULT_LATCHED:
            return Steering.CENTRE if s.t_ns - s.since_ns < CENTRE_NS else Steering.NONE
        case State.FAULT_STOP | State.ESTOP if motor != Motor.SILENT:
            if bits & _STILL:
                return Steering.CENTRE
            return Steering.LIVE if bits & _ESTIMATED else Steering.HOLD
        case _:
            return Steering.NONE


def _count_frames(s: SupervisorState, bits: int) -> int:
    """Brake frames still owed to a port that was just opened."""
    return max(0, s.frames - 1) if bits & _LINKED else OPEN_FRAMES


_WAITING = {
    State.INIT: "VESC firmware, UUID and settings, and a first mocap frame",
    State.DISARMED: "all checks green for 1 s",
    State.READY: "arm",
    State.SELF_TEST: "the VESC's timeout to show",
    State.ARMED: "start",
    State.RUNNING: "stop, or the end of the run",
    State.STOPPING: "the car to stand still",
    State.FAULT_STOP: "the car to stand still",
    State.FAULT_LATCHED: "the cause to go, then clear",
    State.ESTOP: "the car to stand still, then reset",
}


def step(
    old: SupervisorState, conditions: Conditions, requests: int, t_ns: int
) -> tuple[SupervisorState, Action]:
    """One tick of the supervisor.

    Args:
        old: what it remembers.
        conditions: what is true now; must be given at least every 100 ms, or timers start again.
        requests: bits of ``Request``, several at once allowed; the stopping one wins.
        t_ns: now, monotonic.

    Returns:
        The new state, and what this very tick must put on the wire.
    """
    still, green, proof = _renew_timers(old, conditions, t_ns)
    s = old._replace(t_ns=t_ns, still_ns=still, green_ns=green, proof_ns=proof)
    bits = derive(s, conditions, requests, t_ns)
    row = choose(s.state, bits)
    if row is not None and row.to != s.state:
        s = _enter(s, row, conditions, t_ns)
        bits = derive(s, conditions, requests, t_ns)
    else:
        s = s._replace(rearm=bool(bits & _REARM))
    cap = _next_cap(s, old, bits, conditions.speed)
    braking = s.state == State.STOPPING and (
        s.braking or cap < SOFT_BRAKE_SPEED or not abs(conditions.speed) >= SOFT_BRAKE_SPEED
    )
    s = s._replace(cap=cap, braking=braking)
    motor = _choose_motor(s, old, bits)
    steering = _choose_steering(s, bits, motor)
    if s.state == State.INIT:
        s = s._replace(frames=_count_frames(s, bits))
    return s, Action(motor, steering, cap, s.reason, _WAITING[s.state])
