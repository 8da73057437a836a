"""The state machine as one table: states, requests, facts, and the rows that join them.

This is `docs/reference/safety-requirements.md#s3`. ``choose_row`` is all the logic there is;
``supervisor`` derives the facts and says what the wire must carry in each state.
"""

# Why: docs/decisions/safety.md#d13

from enum import IntEnum, IntFlag
from typing import NamedTuple


class SupervisorState(IntEnum):
    """State of the supervisor's state machine; the order carries no meaning."""

    INIT = 0
    DISARMED = 1
    READY = 2
    SELF_TEST = 3
    ARMED = 4
    RUNNING = 5
    STOPPING = 6
    FAULT_STOP = 7
    FAULT_LATCHED = 8
    ESTOP = 9


class Request(IntFlag):
    """Requests of operators and signals in one tick; any other bit counts as UNKNOWN."""

    NONE = 0
    ARM = 1
    START = 2
    STOP = 4
    DISARM = 8
    CLEAR = 16
    ESTOP = 32
    RESET = 64  # leaves ESTOP
    ABORT = 128  # a second signal: stop hard
    UNKNOWN = 256
    KEEPALIVE = 512  # renews the lease (W25), changes no state


class MotorOutput(IntEnum):
    """Kind of motor bytes of a tick."""

    SILENT = 0  # telemetry polls only
    SOFT_BRAKE = 1  # SET_CURRENT_BRAKE(I_soft)
    HOLD_BRAKE = 2  # SET_CURRENT_BRAKE(I_hold)
    DRIVE = 3  # the controller's order through the output limiter
    RAMP_STOP = 4  # the same, under a speed cap that falls
    BRAKE = 5  # SET_CURRENT_BRAKE(I_brake)
    DUTY_ZERO = 6  # SET_DUTY 0, because the brake current does not slow the car
    RELEASE_ONCE = 7  # SET_CURRENT 0
    ESTOP_BRAKE = 8  # SET_CURRENT_BRAKE(I_max)


class SteeringOutput(IntEnum):
    """Kind of servo bytes of a tick; every angle goes through the limiter."""

    NONE = 0
    CENTRE = 1
    LIVE = 2  # the controller's angle
    HOLD = 3  # the last accepted angle, as far as the limiter's lateral acceleration allows it


class Fact:
    """Facts that guards test: the loop gives the first twelve, ``derive_facts`` the others.

    Plain integers: an IntFlag "or" takes a microsecond, and these are tested in every tick.
    """

    LINKED = 1 << 0  # port open
    IDENTIFIED = 1 << 1  # firmware, UUID and appconf prefix match, and mocap has been seen
    CHECKS_PASS = 1 << 2  # every pre-arm check passes now
    FW_TIMEOUT = 1 << 3  # status bit 0 of a fresh GET_VALUES
    LEASED = 1 << 4  # a valid lease, and the deadman where one is required
    SOFT = 1 << 5  # a watchdog asks for STOPPING
    HARD = 1 << 6  # a watchdog asks for FAULT_STOP
    KILLED = 1 << 7  # a watchdog asks for ESTOP
    ENDED = 1 << 8  # the run is over
    LAUNCHED = 1 << 9  # the launch checks have passed
    ESTIMATED = 1 << 10  # the estimator is healthy
    SLOWING = 1 << 11  # the stop works, by the check of W24
    CHECKS_HELD = 1 << 12  # CHECKS_PASS for 1 s
    STILL = 1 << 13  # |v| < 0.05 m/s for 0.3 s, or braked for 2 s without a speed
    MEASURED = 1 << 14  # the speed is known, from any source
    PROVEN = 1 << 15  # FW_TIMEOUT through 210 ms of silence
    ELAPSED = 1 << 16  # the state has lasted as long as it may
    REARM = 1 << 17  # this stop was an operator's and nothing else came up
    ARM = 1 << 18  # from here on Request, in its order
    START = 1 << 19
    STOP = 1 << 20
    DISARM = 1 << 21
    CLEAR = 1 << 22
    CALL_ESTOP = 1 << 23
    RESET = 1 << 24
    ABORT = 1 << 25
    UNKNOWN = 1 << 26


class TransitionRow(NamedTuple):
    """One transition: all of ``needs``, at least one of ``one_of`` (if any), none of ``unless``."""

    sources: tuple[SupervisorState, ...]
    needs: int
    one_of: int
    unless: int
    to: SupervisorState
    reason: str
    """Empty: the watchdog's text."""


_ANY = tuple(SupervisorState)
INIT, DISARMED, READY, SELF_TEST, ARMED, RUNNING, STOPPING, FAULT_STOP, FAULT_LATCHED, ESTOP = _ANY
_SILENT = (DISARMED, READY, SELF_TEST)
_DRIVEN = (ARMED, RUNNING, STOPPING)
_TRIPPED = Fact.SOFT | Fact.HARD
_LEAVE = Fact.DISARM | Fact.UNKNOWN
_HALT = Fact.STOP | Fact.DISARM | Fact.ABORT | Fact.UNKNOWN
STOP_REASON = "stop asked for"
UNPROVEN = (
    "the VESC's timeout did not show: status bit 0 must stay set while no commands are sent."
    " Close VESC Tool and its apps, and set App Settings > General > Timeout to 100-200 ms"
)

# The first row that matches wins. A fault of a car that is not armed is a failed check: the car
# stays silent and disarmed. Faults of an armed car latch.
TABLE: tuple[TransitionRow, ...] = tuple(
    TransitionRow(*row)
    for row in (
        (_ANY, Fact.CALL_ESTOP, 0, 0, ESTOP, "emergency stop called"),
        (_ANY, Fact.KILLED, 0, 0, ESTOP, ""),
        (_DRIVEN, Fact.HARD, 0, 0, FAULT_STOP, ""),
        (_DRIVEN, 0, 0, Fact.LINKED, FAULT_STOP, "serial link lost"),
        (_DRIVEN, Fact.ABORT, 0, 0, FAULT_STOP, "second signal: stopping hard"),
        (_SILENT, 0, 0, Fact.LINKED, INIT, "serial link lost"),
        (_SILENT, 0, 0, Fact.IDENTIFIED, INIT, "VESC or mocap is not what the car file names"),
        ((INIT,), Fact.LINKED | Fact.IDENTIFIED, 0, 0, DISARMED, "VESC identified, mocap seen"),
        ((DISARMED,), Fact.CHECKS_HELD, 0, _TRIPPED, READY, "all checks pass"),
        ((READY, SELF_TEST), 0, _TRIPPED, 0, DISARMED, ""),
        ((READY, SELF_TEST), 0, 0, Fact.CHECKS_PASS, DISARMED, "a pre-arm check failed"),
        ((READY,), Fact.ARM | Fact.LEASED, 0, _HALT, SELF_TEST, "proving the VESC's timeout"),
        ((SELF_TEST,), 0, 0, Fact.LEASED, DISARMED, "lease or deadman lost"),
        ((SELF_TEST,), 0, _HALT, 0, DISARMED, "arming called off"),
        ((SELF_TEST,), Fact.PROVEN, 0, 0, ARMED, "VESC's timeout proven"),
        ((SELF_TEST,), Fact.ELAPSED, 0, Fact.FW_TIMEOUT, DISARMED, UNPROVEN),
        ((ARMED,), Fact.SOFT, 0, 0, DISARMED, ""),
        ((ARMED,), 0, 0, Fact.LEASED, DISARMED, "lease or deadman lost"),
        ((ARMED,), 0, _LEAVE, 0, DISARMED, "disarm asked for"),
        ((ARMED,), Fact.START | Fact.CHECKS_PASS, 0, _HALT, RUNNING, "start asked for"),
        ((ARMED,), Fact.ELAPSED, 0, 0, DISARMED, "armed for 30 s without a start"),
        ((RUNNING,), Fact.SOFT, 0, 0, STOPPING, ""),
        ((RUNNING,), 0, 0, Fact.LEASED, STOPPING, "lease or deadman lost"),
        ((RUNNING,), 0, _LEAVE, 0, STOPPING, "disarm asked for"),
        ((RUNNING,), Fact.STOP, 0, 0, STOPPING, STOP_REASON),
        ((RUNNING,), Fact.ENDED, 0, 0, STOPPING, "end of the run"),
        ((STOPPING,), Fact.STILL | Fact.REARM, 0, 0, ARMED, "stopped"),
        ((STOPPING,), Fact.STILL, 0, 0, DISARMED, "stopped"),
        ((STOPPING,), Fact.ELAPSED, 0, 0, FAULT_STOP, "not stopped after 4 s: braking hard"),
        ((FAULT_STOP,), Fact.STILL, 0, 0, FAULT_LATCHED, ""),
        ((FAULT_LATCHED,), Fact.CLEAR | Fact.STILL, 0, _TRIPPED, DISARMED, "fault cleared"),
        (
            (ESTOP,),
            Fact.RESET | Fact.STILL | Fact.ELAPSED,
            0,
            _TRIPPED,
            DISARMED,
            "emergency stop reset",
        ),
    )
)
ROWS = tuple(tuple(row for row in TABLE if state in row.sources) for state in SupervisorState)


def is_engaged(state: SupervisorState) -> bool:
    """Whether motor bytes flow in this state, so that the guardian must brake if the core dies."""
    return state in (ARMED, RUNNING, STOPPING, FAULT_STOP, ESTOP)


def choose_row(state: SupervisorState, bits: int) -> TransitionRow | None:
    """Return the first row of ``TABLE`` that matches, or None to stay."""
    for row in ROWS[state]:
        if (
            bits & row.needs == row.needs
            and not bits & row.unless
            and (not row.one_of or bits & row.one_of)
        ):
            return row
    return None
