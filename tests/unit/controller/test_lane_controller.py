"""The whole controller, a tick at a time; whole drives are those of `tests/e2e`."""

import math

import pytest

from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.state import ORIGIN, State
from steerd.controller.build import make_controller
from steerd.controller.config import ControllerConfig
from steerd.controller.lane_controller import LaneController, control, start_controller, to_command

RATE_HZ = 100.0
SLOW_SERVO = DEFAULT_CAR._replace(steer_lag=0.08, steer_delay=DEFAULT_CAR.steer_delay + 0.03)
"""30 ms more dead time and 80 ms servo lag."""


def made(
    spec: str, speed: float, car: Car[float] = DEFAULT_CAR, **config: object
) -> LaneController:
    settings = ControllerConfig(speed=speed, **config)  # type: ignore[arg-type]
    return make_controller(car, parse_path(spec), settings, RATE_HZ)


def test_a_cars_gain_and_bias_are_undone():
    crooked = DEFAULT_CAR._replace(steer_gain=0.8, steer_bias=0.05, speed_gain=0.9)
    assert to_command(crooked, 0.05, 0.9) == pytest.approx((0.0, 1.0))


SEEN = ORIGIN._replace(y=0.05, speed=1.0)


def test_a_command_is_remembered_as_it_left():
    controller = made("figure8", 1.5, SLOW_SERVO)
    state = start_controller(controller, SEEN, 0)
    assert len(state.past) == 4
    command, _, after = control(controller, state, SEEN, 10_000_000)
    alone = control(controller, after, SEEN, 20_000_000)
    informed = control(controller, after, SEEN, 20_000_000, issued=command)
    assert informed[0] == pytest.approx(alone[0]), "one that left unchanged changes nothing"
    assert informed[2].past == pytest.approx(alone[2].past)
    held = command._replace(steer=0.5 * command.steer)
    _, _, informed = control(controller, after, SEEN, 20_000_000, issued=held)
    assert informed.past[1] == pytest.approx(held.steer - after.feedforward)


def test_no_delay_means_no_past():
    controller = made("circle", 1.0, DEFAULT_CAR._replace(steer_delay=0.0))
    state = start_controller(controller, SEEN, 0)
    command, _, after = control(controller, state, SEEN, 10_000_000)
    assert after.past == ()
    assert control(controller, after, SEEN, 20_000_000, issued=command)[2].past == ()


def test_a_clock_that_stands_or_leaps_is_no_leap_in_speed():
    controller = made("circle", 1.0)
    state, estimate = start_controller(controller, ORIGIN, 0), ORIGIN
    assert control(controller, state, estimate, 0)[2].speed == 0.0
    assert control(controller, state, estimate, -5)[2].speed == 0.0
    assert control(controller, state, estimate, 10**12)[2].speed == pytest.approx(0.15)


@pytest.mark.parametrize("field", State._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_is_refused(field, value):
    controller = made("circle", 1.0)
    with pytest.raises(ValueError, match="not finite"):
        control(
            controller, start_controller(controller, SEEN, 0), SEEN._replace(**{field: value}), 1
        )


def test_a_start_on_the_crossing_takes_the_branch_the_car_heads_along():
    controller = made("figure8", 1.0)
    path = controller.keeper.path
    other = ORIGIN._replace(yaw=path.yaw[len(path.x) // 2])
    report = control(controller, start_controller(controller, other, 0), other, 0)[1]
    assert report.s == pytest.approx(path.length / 2.0, abs=path.step)
    assert abs(report.e2) < 0.01
