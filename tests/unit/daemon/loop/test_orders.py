"""Orders: each motor output with its current, the limiter on every angle, a missing wish brakes."""

from math import inf, nan

import pytest

from steerd.car_model.state import Command
from steerd.controller.limits import Limits, Verdict, make_limiter_state
from steerd.daemon.loop.orders import make_order
from steerd.daemon.loop.supervisor import Action
from steerd.daemon.loop.transitions import MotorOutput, SteeringOutput
from steerd.daemon.settings.config import BrakeSettings
from steerd.steer_bus.messages import ActuationMode
from steerd.vesc_link.scaling import F1TENTH
from steerd.vesc_link.vesc import Drive

BRAKES = BrakeSettings()
LIMITS = Limits(wheelbase=0.33)
T0, TICK = 10**9, 10_000_000


def brake(current):
    return Drive(ActuationMode.BRAKE, 0.1, current=current)


def same(drive, other):
    """Equal, and without a number where the other is without."""
    return str(drive) == str(other)


def order(motor, steering=SteeringOutput.LIVE, wish=None, speed=1.0, cap=inf, steer=0.1):
    state = make_limiter_state(LIMITS, Command(steer, 1.0), T0)
    action = Action(motor, steering, cap, "", "")
    return make_order(LIMITS, BRAKES, F1TENTH, state, action, wish, speed, T0 + TICK)


@pytest.mark.parametrize(
    ("motor", "drive"),
    [
        (MotorOutput.SOFT_BRAKE, brake(BRAKES.soft_brake_current_a)),
        (MotorOutput.HOLD_BRAKE, brake(BRAKES.hold_brake_current_a)),
        (MotorOutput.BRAKE, brake(BRAKES.brake_current_a)),
        (MotorOutput.ESTOP_BRAKE, brake(BRAKES.estop_brake_current_a)),
        (MotorOutput.DUTY_ZERO, Drive(ActuationMode.SHORT, 0.1)),
        (MotorOutput.RELEASE_ONCE, Drive(ActuationMode.RELEASE, 0.1)),
        (MotorOutput.SILENT, Drive(steer=0.1)),
    ],
)
def test_each_stop_has_its_drive_and_commands_no_speed(motor, drive):
    made = order(motor, SteeringOutput.HOLD, Command(0.3, 3.0))
    assert same(made.drive, drive)
    assert made.command is None
    assert made.limiter.order.speed == 1.0


def test_a_driven_order_is_limited_in_rate_and_under_the_cap():
    made = order(MotorOutput.DRIVE, wish=Command(-0.3, 3.0))
    assert made.drive.mode is ActuationMode.SPEED
    assert made.verdict is Verdict.CLIPPED
    assert made.drive.steer == pytest.approx(0.1 - LIMITS.steer_rate_max * 0.01, abs=1e-3)
    assert made.drive.speed == pytest.approx(1.0 + LIMITS.accel_max * 0.01, abs=1e-3)
    capped = order(MotorOutput.RAMP_STOP, wish=Command(0.1, 3.0), cap=0.99)
    assert capped.drive.speed == pytest.approx(0.99, abs=1e-3)
    assert capped.command == Command(capped.drive.steer, capped.drive.speed)


@pytest.mark.parametrize(
    ("wish", "verdict"),
    [(None, Verdict.PASSED), (Command(nan, 1.0), Verdict.NOT_FINITE),
     (Command(0.0, inf), Verdict.NOT_FINITE)],
)  # fmt: skip
def test_without_a_finite_wish_a_driven_car_brakes(wish, verdict):
    made = order(MotorOutput.DRIVE, wish=wish)
    assert same(made.drive, Drive(ActuationMode.BRAKE, current=BRAKES.brake_current_a))
    assert (made.verdict, made.command) == (verdict, None)


@pytest.mark.parametrize(
    ("steering", "steer"),
    [(SteeringOutput.NONE, None), (SteeringOutput.HOLD, 0.1),
     (SteeringOutput.CENTRE, pytest.approx(0.1 - 0.01 * LIMITS.steer_rate_max)),
     (SteeringOutput.LIVE, pytest.approx(0.1 + 0.01 * LIMITS.steer_rate_max))],
)  # fmt: skip
def test_the_angle_of_a_stop_follows_the_steering_output(steering, steer):
    assert order(MotorOutput.BRAKE, steering, Command(0.3, 0.0)).drive.steer == steer


def test_an_unknown_speed_counts_as_the_highest():
    made = order(MotorOutput.BRAKE, SteeringOutput.HOLD, speed=nan, steer=0.3)
    assert made.drive.steer < 0.3, "the lateral acceleration at full speed allows less"
    assert made.limiter.order.speed == LIMITS.speed_max
