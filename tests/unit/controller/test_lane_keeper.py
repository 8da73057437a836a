"""Lane errors and the steering law, a tick at a time."""

import math

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import Projection, interpolate, project
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.state import ORIGIN, State
from steerd.controller.gain_table import N_LANE, Turning
from steerd.controller.lane_keeper import LaneErrors, LaneKeeper, lane_errors, step

LINE = parse_path("line:length=10")
LEFT = parse_path("circle:radius=2")
KEEPER = LaneKeeper(LINE, 0.06, -0.34, 0.34)
NO_TURNING = Turning(0.33, 0.0, -0.15, 0.0)


def row(past: tuple[float, ...] = (), **gains: float) -> tuple[float, ...]:
    names = ("e1", "e1_rate", "e2", "e2_rate", "steer")
    assert len(names) == N_LANE
    return (*(gains.get(name, 0.0) for name in names), *past, *NO_TURNING)


def test_signs_left_of_the_line_and_turned_left() -> None:
    estimate = State(1.0, 0.1, 0.2, 1.5, 0.3, 0.05, 0.0)
    errors = lane_errors(estimate, project(LINE, 1.0, 0.1, 50))
    assert errors.e1 == pytest.approx(0.1)
    assert errors.e2 == pytest.approx(0.2)
    assert errors.e1_rate == pytest.approx(1.5 * math.sin(0.25))
    assert errors.e2_rate == pytest.approx(0.3)


def test_heading_error_wraps() -> None:
    at = project(LINE, 1.0, 0.0, 50)
    for turns in (-2, 0, 3):
        estimate = ORIGIN._replace(x=1.0, yaw=0.1 + turns * math.tau)
        assert lane_errors(estimate, at).e2 == pytest.approx(0.1)


def test_at_the_centre_of_the_turn_the_rates_stay_finite() -> None:
    estimate = State(0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    errors = lane_errors(estimate, project(LEFT, 0.0, 2.0, 0))
    assert errors.e2_rate == pytest.approx(-0.5 / 0.1)


def wheel_reference(
    gains: tuple[float, ...], errors: LaneErrors, past: tuple[float, ...] = ()
) -> float:
    at = Projection(1.0, 50, errors.e1, 0.0, 0.0, abs(errors.e1))
    return step(KEEPER, gains, errors, at, ORIGIN._replace(speed=1.0, steer=0.1), past).wheel


def test_each_gain_steers_against_its_error() -> None:
    errors = LaneErrors(0.1, 0.2, 0.03, 0.4)
    assert wheel_reference(row(e1=2.0), errors) == pytest.approx(-0.2)
    assert wheel_reference(row(e1_rate=0.5), errors) == pytest.approx(-0.1)
    assert wheel_reference(row(e2=2.0), errors) == pytest.approx(-0.06)
    assert wheel_reference(row(e2_rate=0.5), errors) == pytest.approx(-0.2)
    assert wheel_reference(row(steer=0.5), errors) == pytest.approx(-0.05)
    assert wheel_reference(row(past=(0.5, 0.25)), errors, (0.1, -0.4)) == pytest.approx(0.05)


def test_the_order_stays_within_the_end_stops() -> None:
    assert wheel_reference(row(e1=100.0), LaneErrors(1.0, 0.0, 0.0, 0.0)) == KEEPER.wheel_min
    assert wheel_reference(row(e1=100.0), LaneErrors(-1.0, 0.0, 0.0, 0.0)) == KEEPER.wheel_max


def test_a_past_that_does_not_fit_the_table_is_an_error() -> None:
    with pytest.raises(ValueError, match="zip"):
        wheel_reference(row(past=(0.5,)), LaneErrors(0.0, 0.0, 0.0, 0.0), (0.1, 0.2))


def test_the_curvature_is_read_where_the_order_will_act() -> None:
    eight = parse_path("figure8")
    keeper = LaneKeeper(eight, 0.2, -0.34, 0.34)
    at = project(eight, eight.x[100], eight.y[100], 100)
    estimate = ORIGIN._replace(speed=2.0, steer=DEFAULT_CAR.steer_bias)
    order = step(keeper, row(), LaneErrors(0.0, 0.0, 0.0, 0.0), at, estimate, ())
    assert order.feedforward == pytest.approx(
        0.33 * interpolate(eight, eight.curvature, at.s + 0.4)
    )
