"""From the supervisor's action and the controller's wish to the wire, through the gate."""

from dataclasses import dataclass
from math import isfinite

from steerd.car_model.state import Command
from steerd.controller.limits import Gated, GateState, Limits, Verdict, gate, make_gate_state
from steerd.daemon.loop.supervisor import Action
from steerd.daemon.loop.transitions import MotorOutput, SteeringOutput
from steerd.daemon.settings.config import BrakeSettings
from steerd.vesc_link.events import (
    Drive,
    DriveBrake,
    DriveRelease,
    DriveShort,
    DriveSilent,
    DriveSpeed,
)
from steerd.vesc_link.scaling import Scaling, as_sent

_DRIVEN = (MotorOutput.DRIVE, MotorOutput.RAMP_STOP)


@dataclass(frozen=True)
class Order:
    """What leaves in this tick.

    Attributes:
        drive: for the wire.
        gate: the gate's state after it.
        command: what the car was told to aim at, for filter and controller; None when the motor
            does not follow a speed.
        verdict: the gate's; NOT_FINITE means that this order brakes instead.
    """

    drive: Drive
    gate: GateState
    command: Command[float] | None
    verdict: Verdict


def make_order(
    limits: Limits,
    brakes: BrakeSettings,
    scaling: Scaling,
    state: GateState,
    action: Action,
    wish: Command[float] | None,
    speed: float,
    t_ns: int,
) -> Order:
    """Carry out an action; a wish that is missing or not finite brakes.

    Args:
        limits: of the gate.
        brakes: currents.
        scaling: of the VESC: an order is what it can be told.
        state: of the gate.
        action: the supervisor's.
        wish: the controller's, None if it has none.
        speed: the car's, best known [m/s].
        t_ns: now.
    """
    measured = speed if isfinite(speed) else limits.speed_max
    driven = action.motor in _DRIVEN
    gated = gate(limits, state, _aim(action, state, wish, measured), measured, action.cap, t_ns)
    if driven and (wish is None or gated.verdict is Verdict.NOT_FINITE):
        drive: Drive = DriveBrake(None, brakes.brake_current_a)
        return Order(drive, state, None, Verdict.NOT_FINITE if wish else Verdict.PASSED)
    if driven:
        sent = Command(*as_sent(scaling, gated.order.steer, gated.order.speed))
        return Order(DriveSpeed(*sent), gated.state, sent, gated.verdict)
    steer = None if action.steering is SteeringOutput.NONE else gated.order.steer
    rolling = _rolling(limits, gated, measured, t_ns)
    return Order(_undriven(action.motor, brakes, steer), rolling, None, gated.verdict)


def _aim(
    action: Action, state: GateState, wish: Command[float] | None, speed: float
) -> Command[float]:
    steer = state.order.steer
    if action.steering is SteeringOutput.CENTRE:
        steer = 0.0
    elif action.steering is SteeringOutput.LIVE and wish is not None:
        steer = wish.steer
    return Command(steer, wish.speed if wish is not None and action.motor in _DRIVEN else speed)


def _rolling(limits: Limits, gated: Gated, speed: float, t_ns: int) -> GateState:
    """The gate's state while nothing follows a speed: the next order starts from the real one."""
    order = Command(gated.order.steer, max(speed, 0.0))
    return make_gate_state(limits, order, t_ns)


def _undriven(motor: MotorOutput, brakes: BrakeSettings, steer: float | None) -> Drive:
    match motor:
        case MotorOutput.SOFT_BRAKE:
            return DriveBrake(steer, brakes.soft_brake_current_a)
        case MotorOutput.HOLD_BRAKE:
            return DriveBrake(steer, brakes.hold_brake_current_a)
        case MotorOutput.BRAKE:
            return DriveBrake(steer, brakes.brake_current_a)
        case MotorOutput.ESTOP_BRAKE:
            return DriveBrake(steer, brakes.estop_brake_current_a)
        case MotorOutput.DUTY_ZERO:
            return DriveShort(steer)
        case MotorOutput.RELEASE_ONCE:
            return DriveRelease(steer)
        case _:
            return DriveSilent(steer)
