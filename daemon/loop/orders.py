"""From the supervisor's action and the controller's wish to the wire, through the limiter."""

from collections.abc import Callable, Mapping
from math import isfinite
from operator import attrgetter

from steerd.car_model.state import Command
from steerd.controller.lane_controller import ControlReport
from steerd.controller.limits import LimiterState, Verdict, limit_order, make_limiter_state
from steerd.daemon.loop.findings import Finding
from steerd.daemon.loop.supervisor import Action, SupervisorMemory
from steerd.daemon.loop.transitions import MotorOutput, SteeringOutput, SupervisorState
from steerd.daemon.settings.config import BrakeSettings, Settings
from steerd.estimator.state_filter import StateEstimate
from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.quick_values import quick_value
from steerd.vesc_link.scaling import as_sent
from steerd.vesc_link.vesc import Drive

_DRIVEN = (MotorOutput.DRIVE, MotorOutput.RAMP_STOP)
_CURRENTS: Mapping[MotorOutput, Callable[[BrakeSettings], float]] = {
    MotorOutput.SOFT_BRAKE: attrgetter("soft_brake_current_a"),
    MotorOutput.HOLD_BRAKE: attrgetter("hold_brake_current_a"),
    MotorOutput.BRAKE: attrgetter("brake_current_a"),
    MotorOutput.ESTOP_BRAKE: attrgetter("estop_brake_current_a"),
}
_UNBRAKED = {
    MotorOutput.DUTY_ZERO: ActuationMode.SHORT,
    MotorOutput.RELEASE_ONCE: ActuationMode.RELEASE,
}
"""Ways to stop without a brake current; all that is not listed is silent."""


@quick_value
class Order:
    """What leaves in this tick."""

    drive: Drive  # for the wire
    limiter: LimiterState  # state of the output limiter after it
    # The command as sent, for filter and controller; None when the motor does not follow a speed
    command: Command[float] | None
    verdict: Verdict  # of the limiter; NOT_FINITE means that this order brakes instead


@quick_value
class TickResult:
    """Decision of one tick and its inputs."""

    order: Order  # for the wire
    old: SupervisorState  # the supervisor's state before the tick
    supervisor: SupervisorMemory  # the supervisor after it
    estimate: StateEstimate | None  # of the car's state, None before the first
    report: ControlReport | None  # of the lane keeper, None without an estimate
    findings: tuple[Finding, ...]  # of the watchdogs
    waiting: str  # what the supervisor waits for, for people
    facts: int  # bits of `Fact`


def make_order(
    settings: Settings,
    state: LimiterState,
    action: Action,
    wish: Command[float] | None,
    speed: float,
    t_ns: int,
) -> Order:
    """Make the order for an action; a wish that is missing or not finite brakes.

    Orders are rounded to what the VESC's scaling can express; `speed` is the best known [m/s].
    """
    limits, brakes, scaling = settings.limits, settings.brakes, settings.scaling
    measured = speed if isfinite(speed) else limits.speed_max
    driven = action.motor in _DRIVEN
    limited = limit_order(
        limits, state, _make_target(action, state, wish, measured), measured, action.cap, t_ns
    )
    if driven and (wish is None or limited.verdict is Verdict.NOT_FINITE):
        drive = Drive(ActuationMode.BRAKE, current=brakes.brake_current_a)
        return Order(drive, state, None, Verdict.NOT_FINITE if wish else Verdict.PASSED)
    if driven:
        sent = Command(*as_sent(scaling, limited.order.steer, limited.order.speed))
        drive = Drive(ActuationMode.SPEED, sent.steer, sent.speed)
        return Order(drive, limited.state, sent, limited.verdict)
    steer = None if action.steering is SteeringOutput.NONE else limited.order.steer
    # While no speed is commanded, the next order starts from the measured one.
    seen = Command(limited.order.steer, max(measured, 0.0))
    rolling = make_limiter_state(limits, seen, t_ns)
    if action.motor in _CURRENTS:
        drive = Drive(ActuationMode.BRAKE, steer, current=_CURRENTS[action.motor](brakes))
    else:
        drive = Drive(_UNBRAKED.get(action.motor, ActuationMode.SILENT), steer)
    return Order(drive, rolling, None, limited.verdict)


def _make_target(
    action: Action, state: LimiterState, wish: Command[float] | None, speed: float
) -> Command[float]:
    steer = state.order.steer
    if action.steering is SteeringOutput.CENTRE:
        steer = 0.0
    elif action.steering is SteeringOutput.LIVE and wish is not None:
        steer = wish.steer
    return Command(steer, wish.speed if wish is not None and action.motor in _DRIVEN else speed)
