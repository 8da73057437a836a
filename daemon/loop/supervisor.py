"""The supervisor: who may move the car, and how it stops; one pure function over a table.

``step_supervisor`` turns measured conditions (``Conditions``) and requests (facts of ``ASKED``)
into guard bits, takes the first row of ``transitions.TABLE`` that matches, and gives the kinds of
motor and servo bytes. The invariants I1-I8 of
`docs/reference/safety-requirements.md#invariants` are enumerated over it in the tests. No clock,
no I/O, no randomness.
"""

# Why: docs/decisions/safety.md#d12

from math import inf, isfinite

from steerd.daemon.loop import transitions as tr
from steerd.daemon.loop.transitions import Fact, MotorOutput, SteeringOutput, SupervisorState
from steerd.daemon.settings.thresholds import LAUNCH_SPEED, SOFT_DECEL
from steerd.steer_bus.quick_values import changed, quick_value

STILL_SPEED = 0.05  # [m/s] slower than this is standing
SOFT_BRAKE_SPEED = 0.3  # [m/s] below it a VESC's speed loop releases: brake current takes over
OPEN_FRAMES = 3  # brake frames after the port was (re)opened
STILL_NS = 300_000_000  # a car that is slow for so long stands
CHECKS_HOLD_NS = 1_000_000_000  # the pre-arm checks must pass for so long
PROOF_NS = 210_000_000  # longer than the 200 ms between the ALIVEs of a forgotten VESC Tool
PROOF_SLACK_NS = 50_000_000
CENTRE_NS = 500_000_000  # full lock to centre takes 0.1 s; the rest is for lost frames
GAP_NS = 100_000_000  # after a longer gap between two ticks all timers start again
BLIND_NS = 2 * 10**9 - STILL_NS  # braking for so long, without a speed, counts as slow
NEVER = -1  # value of a timer whose condition does not hold
DURATIONS_NS = {
    SupervisorState.ARMED: 30 * 10**9,
    SupervisorState.STOPPING: 4 * 10**9,
    SupervisorState.ESTOP: 2 * 10**9,
}


@quick_value
class Conditions:
    """Measured conditions of one tick."""

    facts: int  # those of `GIVEN` that hold
    speed: float  # best known speed [m/s]; NaN when no source gives it
    timeout_ns: int  # the VESC's own timeout as read from its appconf
    text: str = ""  # text of the worst watchdog trip, for the log and for people


@quick_value
class SupervisorMemory:
    """The supervisor's memory between ticks; times are [ns], monotonic."""

    state: SupervisorState  # of the state machine
    t_ns: int  # time of the last tick
    since_ns: int  # time at which the state was entered
    reason: str  # why
    still_ns: int  # since when the car stands, or ``NEVER``
    checks_ns: int  # since when the pre-arm checks pass, or ``NEVER``
    proof_ns: int  # since when the VESC shows its timeout, or ``NEVER``
    cap: float  # highest speed that may be ordered [m/s]
    rearm: bool  # whether the car goes back to ARMED after this stop
    braking: bool  # whether brake current has taken over from the speed ramp
    frames: int  # brake frames still to be sent to a port that was just opened


@quick_value
class Action:
    """What this tick must put on the wire."""

    motor: MotorOutput  # kind of motor bytes
    steering: SteeringOutput  # kind of servo bytes
    cap: float  # highest speed that may be ordered [m/s]; ``inf`` where only the car's limits apply


_SPOILS_REARM = Fact.SOFT | Fact.DISARM | Fact.UNKNOWN


def make_supervisor_memory(t_ns: int) -> SupervisorMemory:
    """Return the state of a process that has just started: INIT, nothing proven."""
    return SupervisorMemory(
        SupervisorState.INIT, t_ns, t_ns, "started", NEVER, NEVER, NEVER, 0.0, False, False,
        OPEN_FRAMES,
    )  # fmt: skip


def _since(holds: object, began: int, t_ns: int) -> int:
    """When a condition was first seen to hold, ``NEVER`` while it does not."""
    if not holds:
        return NEVER
    return t_ns if began == NEVER else began


def _renew_timers(s: SupervisorMemory, c: Conditions, t_ns: int) -> tuple[int, int, int]:
    """Return since when the car stands, the checks pass, the timeout is shown."""
    if not 0 <= t_ns - s.t_ns <= GAP_NS:
        return NEVER, NEVER, NEVER
    blind = s.state in tr.BRAKED and not isfinite(c.speed) and t_ns - s.since_ns >= BLIND_NS
    still = blind or -STILL_SPEED < c.speed < STILL_SPEED
    proof = c.facts & Fact.FW_TIMEOUT and s.state == SupervisorState.SELF_TEST
    return (
        _since(still, s.still_ns, t_ns),
        _since(c.facts & Fact.CHECKS_PASS, s.checks_ns, t_ns),
        _since(proof, s.proof_ns, t_ns),
    )


def _held(began: int, t_ns: int, duration_ns: int) -> bool:
    return began != NEVER and t_ns - began >= duration_ns


def stands(s: SupervisorMemory, t_ns: int) -> bool:
    """Whether the car stands, or has been braked for 2 s without a speed."""
    return _held(s.still_ns, t_ns, STILL_NS)


def derive_facts(s: SupervisorMemory, c: Conditions, requests: int, t_ns: int) -> int:
    """Return all guard bits (`Fact`); the timers in ``s`` must be those of this tick.

    A bit of ``requests`` that is none counts as an unknown request.
    """
    bits = c.facts & tr.GIVEN | requests & tr.ASKED
    if requests & ~tr.ASKED:
        bits |= Fact.UNKNOWN
    if _held(s.checks_ns, t_ns, CHECKS_HOLD_NS):
        bits |= Fact.CHECKS_HELD
    if stands(s, t_ns):
        bits |= Fact.STILL
    if isfinite(c.speed):
        bits |= Fact.MEASURED
    if _held(s.proof_ns, t_ns, PROOF_NS):
        bits |= Fact.PROVEN
    allowed = DURATIONS_NS.get(s.state)
    if s.state == SupervisorState.SELF_TEST:
        allowed = c.timeout_ns + PROOF_SLACK_NS
    if allowed is not None and t_ns - s.since_ns >= allowed:
        bits |= Fact.ELAPSED
    if s.state == SupervisorState.INIT and s.frames:
        bits &= ~Fact.IDENTIFIED
    if s.rearm and not bits & _SPOILS_REARM and bits & Fact.LEASED:
        bits |= Fact.REARM
    return bits


def _enter(
    s: SupervisorMemory, row: tr.TransitionRow, c: Conditions, t_ns: int
) -> SupervisorMemory:
    text = s.reason if row.to == SupervisorState.FAULT_LATCHED else c.text
    reason = row.reason or text or "a watchdog tripped"
    return changed(
        s, state=row.to, since_ns=t_ns, reason=reason, checks_ns=NEVER, proof_ns=NEVER,
        rearm=row.reason == tr.STOP_REASON, braking=False,
        frames=OPEN_FRAMES if row.to == SupervisorState.INIT else s.frames,
    )  # fmt: skip


def _next_cap(s: SupervisorMemory, old: SupervisorMemory, bits: int, speed: float) -> float:
    """Speed cap [m/s]; while stopping it only falls, from the measured speed."""
    if s.state == SupervisorState.RUNNING:
        # At the start of a drive LAUNCHED is still that of the drive before.
        launched = old.state == SupervisorState.RUNNING and bits & Fact.LAUNCHED
        return inf if launched else LAUNCH_SPEED
    if s.state != SupervisorState.STOPPING:
        return 0.0
    if old.state != SupervisorState.STOPPING:
        return min(old.cap, abs(speed)) if bits & Fact.MEASURED else 0.0
    return max(0.0, old.cap - SOFT_DECEL * max(0, s.t_ns - old.t_ns) * 1e-9)


def _choose_motor(s: SupervisorMemory, old: SupervisorMemory, bits: int) -> MotorOutput:
    """Motor bytes by state; `docs/reference/safety-requirements.md#s3.1`."""
    match s.state:
        case SupervisorState.INIT:
            return MotorOutput.SOFT_BRAKE if s.frames and bits & Fact.LINKED else MotorOutput.SILENT
        case SupervisorState.ARMED:
            return MotorOutput.HOLD_BRAKE
        case SupervisorState.RUNNING:
            return MotorOutput.DRIVE
        case SupervisorState.STOPPING:
            return MotorOutput.SOFT_BRAKE if s.braking else MotorOutput.RAMP_STOP
        case SupervisorState.FAULT_STOP:
            return MotorOutput.BRAKE if bits & Fact.SLOWING else MotorOutput.DUTY_ZERO
        case SupervisorState.FAULT_LATCHED if old.state != SupervisorState.FAULT_LATCHED:
            return MotorOutput.RELEASE_ONCE
        case SupervisorState.ESTOP if not (bits & Fact.ELAPSED and bits & Fact.STILL):
            return MotorOutput.ESTOP_BRAKE if bits & Fact.SLOWING else MotorOutput.DUTY_ZERO
        case _:
            return MotorOutput.SILENT


def _choose_steering(s: SupervisorMemory, bits: int, motor: MotorOutput) -> SteeringOutput:
    """Servo bytes by state; `docs/reference/safety-requirements.md#s3.1`."""
    match s.state:
        case SupervisorState.ARMED:
            return SteeringOutput.CENTRE
        case SupervisorState.RUNNING | SupervisorState.STOPPING:
            return SteeringOutput.LIVE
        case SupervisorState.DISARMED | SupervisorState.FAULT_LATCHED:
            return SteeringOutput.CENTRE if s.t_ns - s.since_ns < CENTRE_NS else SteeringOutput.NONE
        case SupervisorState.FAULT_STOP | SupervisorState.ESTOP if motor != MotorOutput.SILENT:
            if bits & Fact.STILL:
                return SteeringOutput.CENTRE
            return SteeringOutput.LIVE if bits & Fact.ESTIMATED else SteeringOutput.HOLD
        case _:
            return SteeringOutput.NONE


WAITING = {
    SupervisorState.INIT: "VESC firmware, UUID and settings, and a first mocap frame",
    SupervisorState.DISARMED: "all checks to pass for 1 s",
    SupervisorState.READY: "arm",
    SupervisorState.SELF_TEST: "the VESC's timeout to show",
    SupervisorState.ARMED: "start",
    SupervisorState.RUNNING: "stop, or the end of the run",
    SupervisorState.STOPPING: "the car to stand still",
    SupervisorState.FAULT_STOP: "the car to stand still",
    SupervisorState.FAULT_LATCHED: "the cause to go, then clear",
    SupervisorState.ESTOP: "the car to stand still, then reset",
}
"""What a state waits for, for people."""


def step_supervisor(
    old: SupervisorMemory, conditions: Conditions, requests: int, t_ns: int
) -> tuple[SupervisorMemory, Action]:
    """One tick of the supervisor: its new memory, and what this tick must put on the wire.

    After a gap of more than 100 ms between two ticks timers start again. Of several ``requests``
    (facts of ``ASKED``) the stopping one wins.
    """
    still, checks, proof = _renew_timers(old, conditions, t_ns)
    s = changed(old, t_ns=t_ns, still_ns=still, checks_ns=checks, proof_ns=proof)
    bits = derive_facts(s, conditions, requests, t_ns)
    row = tr.choose_row(s.state, bits)
    if row is not None and row.to != s.state:
        s = _enter(s, row, conditions, t_ns)
        bits = derive_facts(s, conditions, requests, t_ns)
        rearm = s.rearm
    else:
        rearm = bool(bits & Fact.REARM)
    cap = _next_cap(s, old, bits, conditions.speed)
    braking = s.state == SupervisorState.STOPPING and (
        s.braking or cap < SOFT_BRAKE_SPEED or not abs(conditions.speed) >= SOFT_BRAKE_SPEED
    )
    s = changed(s, cap=cap, rearm=rearm, braking=braking)
    motor = _choose_motor(s, old, bits)
    steering = _choose_steering(s, bits, motor)
    if s.state == SupervisorState.INIT:  # a port that was just opened
        s = changed(s, frames=max(0, s.frames - 1) if bits & Fact.LINKED else OPEN_FRAMES)
    return s, Action(motor, steering, cap)
