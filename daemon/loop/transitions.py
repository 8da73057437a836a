"""The state machine as one table: states, facts, and the rows that join them.

This is `docs/reference/safety-requirements.md#s3`. ``choose_row`` is all the logic there is;
``supervisor`` derives the facts and says what the wire must carry in each state.
"""

# Why: docs/decisions/safety.md#d13

from enum import IntEnum
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

    @property
    def engaged(self) -> bool:
        """Whether motor bytes flow, so that the guardian must brake if the core dies."""
        return self in HELD or self in BRAKED


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
    """Facts that guards test: the loop gives those of `GIVEN`, ``derive_facts`` the others.

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
    ARM = 1 << 18  # from here on requests
    START = 1 << 19
    STOP = 1 << 20
    DISARM = 1 << 21
    CLEAR = 1 << 22
    CALL_ESTOP = 1 << 23
    RESET = 1 << 24  # leaves ESTOP
    ABORT = 1 << 25  # a second signal: stop hard
    UNKNOWN = 1 << 26  # any other bit of a request


class TransitionRow(NamedTuple):
    """One transition, by the facts that it tests."""

    sources: tuple[SupervisorState, ...]
    to: SupervisorState
    reason: str  # empty: the watchdog's text
    needs: int = 0  # all of these hold
    one_of: int = 0  # at least one of these holds, if any is named
    unless: int = 0  # none of these holds


_ANY = tuple(SupervisorState)
INIT, DISARMED, READY, SELF_TEST, ARMED, RUNNING, STOPPING, FAULT_STOP, FAULT_LATCHED, ESTOP = _ANY
_SILENT = (DISARMED, READY, SELF_TEST)
PARKED = (INIT, DISARMED, READY, FAULT_LATCHED)  # no motor command is sent
HELD = (ARMED, RUNNING, STOPPING)  # somebody must hold the car
DRIVING = (RUNNING, STOPPING)
BRAKED = (FAULT_STOP, ESTOP)  # the car is being stopped hard
_TRIPPED = Fact.SOFT | Fact.HARD
_LEAVE = Fact.DISARM | Fact.UNKNOWN
_HALT = Fact.STOP | Fact.DISARM | Fact.ABORT | Fact.UNKNOWN
STOP_REASON = "stop asked for"
UNPROVEN = (
    "the VESC's timeout did not show: status bit 0 must stay set while no commands are sent."
    " Close VESC Tool and its apps, and set App Settings > General > Timeout to 100-200 ms"
)

ASKED = (
    Fact.ARM | Fact.START | Fact.STOP | Fact.DISARM | Fact.CLEAR | Fact.CALL_ESTOP | Fact.RESET
    | Fact.ABORT | Fact.UNKNOWN
)  # fmt: skip
"""Facts that are requests of operators and of signals."""
GIVEN = (
    Fact.LINKED | Fact.IDENTIFIED | Fact.CHECKS_PASS | Fact.FW_TIMEOUT | Fact.LEASED | Fact.SOFT
    | Fact.HARD | Fact.KILLED | Fact.ENDED | Fact.LAUNCHED | Fact.ESTIMATED | Fact.SLOWING
)  # fmt: skip
"""Facts that the loop gives; the others are derived from requests and timers."""

# The first row that matches wins. A fault of a car that is not armed is a failed check: the car
# stays silent and disarmed. Faults of an armed car latch.
_row = TransitionRow
TABLE: tuple[TransitionRow, ...] = (
    _row(_ANY, ESTOP, "emergency stop called", needs=Fact.CALL_ESTOP),
    _row(_ANY, ESTOP, "", needs=Fact.KILLED),
    _row(HELD, FAULT_STOP, "", needs=Fact.HARD),
    _row(HELD, FAULT_STOP, "serial link lost", unless=Fact.LINKED),
    _row(HELD, FAULT_STOP, "second signal: stopping hard", needs=Fact.ABORT),
    _row(_SILENT, INIT, "serial link lost", unless=Fact.LINKED),
    _row(_SILENT, INIT, "VESC or mocap is not what the car file names", unless=Fact.IDENTIFIED),
    _row((INIT,), DISARMED, "VESC identified, mocap seen", needs=Fact.LINKED | Fact.IDENTIFIED),
    _row((DISARMED,), READY, "all checks pass", needs=Fact.CHECKS_HELD, unless=_TRIPPED),
    _row((READY, SELF_TEST), DISARMED, "", one_of=_TRIPPED),
    _row((READY, SELF_TEST), DISARMED, "a pre-arm check failed", unless=Fact.CHECKS_PASS),
    _row((READY,), SELF_TEST, "proving the VESC's timeout",
         needs=Fact.ARM | Fact.LEASED, unless=_HALT),
    _row((SELF_TEST,), DISARMED, "lease or deadman lost", unless=Fact.LEASED),
    _row((SELF_TEST,), DISARMED, "arming called off", one_of=_HALT),
    _row((SELF_TEST,), ARMED, "VESC's timeout proven", needs=Fact.PROVEN),
    _row((SELF_TEST,), DISARMED, UNPROVEN, needs=Fact.ELAPSED, unless=Fact.FW_TIMEOUT),
    _row((ARMED,), DISARMED, "", needs=Fact.SOFT),
    _row((ARMED,), DISARMED, "lease or deadman lost", unless=Fact.LEASED),
    _row((ARMED,), DISARMED, "disarm asked for", one_of=_LEAVE),
    _row((ARMED,), RUNNING, "start asked for", needs=Fact.START | Fact.CHECKS_PASS, unless=_HALT),
    _row((ARMED,), DISARMED, "armed for 30 s without a start", needs=Fact.ELAPSED),
    _row((RUNNING,), STOPPING, "", needs=Fact.SOFT),
    _row((RUNNING,), STOPPING, "lease or deadman lost", unless=Fact.LEASED),
    _row((RUNNING,), STOPPING, "disarm asked for", one_of=_LEAVE),
    _row((RUNNING,), STOPPING, STOP_REASON, needs=Fact.STOP),
    _row((RUNNING,), STOPPING, "end of the run", needs=Fact.ENDED),
    _row((STOPPING,), ARMED, "stopped", needs=Fact.STILL | Fact.REARM),
    _row((STOPPING,), DISARMED, "stopped", needs=Fact.STILL),
    _row((STOPPING,), FAULT_STOP, "not stopped after 4 s: braking hard", needs=Fact.ELAPSED),
    _row((FAULT_STOP,), FAULT_LATCHED, "", needs=Fact.STILL),
    _row((FAULT_LATCHED,), DISARMED, "fault cleared",
         needs=Fact.CLEAR | Fact.STILL, unless=_TRIPPED),
    _row((ESTOP,), DISARMED, "emergency stop reset",
         needs=Fact.RESET | Fact.STILL | Fact.ELAPSED, unless=_TRIPPED),
)  # fmt: skip
ROWS = tuple(tuple(row for row in TABLE if state in row.sources) for state in SupervisorState)


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
