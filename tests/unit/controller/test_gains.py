"""The designs against what they promise, and the table's lookup."""

import control as reference  # noqa: TID251
import numpy as np
import pytest

from steerd.car_model.linear import lane_error_model
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.controller.config import PAPER_POLES, ControllerConfig, LqrWeights
from steerd.controller.design import DesignRefused
from steerd.controller.gain_table import GainTable, Turning, look_up
from steerd.controller.gains import design_table, lqr_gains, pole_placement_gains
from steerd.controller.loop_model import Timing, sampled_loop, turn_response
from tests.textbook import feedforward_steer, steady_slip

TIMING = Timing(rate_hz=100.0, delay_s=0.025, lag_s=0.05)


@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0])
def test_pole_placement_puts_the_continuous_poles(speed: float) -> None:
    errors = lane_error_model(PAPER_CAR, speed)
    gains = pole_placement_gains(PAPER_CAR, speed, PAPER_POLES)
    poles = np.linalg.eigvals(errors.a - errors.b_steer[:, None] @ gains)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(PAPER_POLES), rtol=1e-6)


@pytest.mark.parametrize("speed", [0.7, 1.5, 6.0])
@pytest.mark.parametrize("timing", [TIMING, Timing(50.0, 0.0, 0.0)])
def test_both_designs_give_the_bits_of_python_control(speed: float, timing: Timing) -> None:
    errors, weights = lane_error_model(DEFAULT_CAR, speed), LqrWeights()
    placed = reference.place(errors.a, errors.b_steer[:, None], PAPER_POLES)
    assert np.array_equal(pole_placement_gains(DEFAULT_CAR, speed, PAPER_POLES), placed)
    a, b = sampled_loop(DEFAULT_CAR, speed, timing)
    cost = np.zeros(len(a))
    lane = 5 if timing.lagging else 4
    cost[:lane] = weights[:lane]
    optimal = reference.dlqr(a, b, np.diag(cost), [[weights.effort]])[0]
    assert np.array_equal(lqr_gains(DEFAULT_CAR, speed, timing, weights), optimal)


def test_poles_that_cannot_be_placed_are_refused() -> None:
    with pytest.raises(DesignRefused, match=r"pole_placement at 1\.00 m/s"):
        pole_placement_gains(PAPER_CAR, 1.0, (-2, -2, -2, -2))


def cost_of(gains: np.ndarray, weights: LqrWeights) -> float:
    """Sum over time of the quadratic cost from an offset, by running the loop."""
    a, b = sampled_loop(DEFAULT_CAR, 1.0, TIMING)
    x, total = np.zeros(len(a)), 0.0
    x[0] = 1.0
    for _ in range(3000):
        u = float(-(gains @ x).item())
        total += float(x[:5] ** 2 @ np.array(weights[:5])) + weights.effort * u * u
        x = a @ x + b[:, 0] * u
    return total


def test_lqr_is_the_cheapest_of_its_neighbours() -> None:
    weights = LqrWeights()
    best = lqr_gains(DEFAULT_CAR, 1.0, TIMING, weights)
    assert best.shape == (1, 5 + 3)  # 25 ms at 100 Hz: three references under way
    lowest = cost_of(best, weights)
    rng = np.random.default_rng(1)
    for _ in range(10):
        nearby = best * (1.0 + 0.05 * rng.standard_normal(best.shape))
        assert cost_of(nearby, weights) > lowest


def test_lqr_without_lag_or_delay_feeds_back_the_lane_errors_alone() -> None:
    config = ControllerConfig()
    table = design_table(DEFAULT_CAR, config, Timing(100.0, 0.0, 0.0), 1.0)
    assert table.pasts == 0
    assert all(row[4] == 0.0 for row in table.rows)


def test_the_table_spans_the_speeds() -> None:
    table = design_table(DEFAULT_CAR, ControllerConfig(), TIMING, 1.6)
    assert table.speeds[0] == 0.1
    assert table.speeds[-1] == pytest.approx(1.6)
    assert table.spacing <= 0.25
    assert table.pasts == 3
    slow = design_table(DEFAULT_CAR, ControllerConfig(), TIMING, 0.05)
    assert slow.speeds == (0.1,)
    by_poles = ControllerConfig(design="pole_placement")
    assert design_table(DEFAULT_CAR, by_poles, TIMING, 1.0).speeds[0] == 0.5


def test_lookup_is_linear_between_and_holds_outside() -> None:
    table = GainTable(1.0, 0.5, ((0.0, 10.0), (1.0, 20.0), (5.0, 0.0)))
    assert look_up(table, 1.25) == (0.5, 15.0)
    assert look_up(table, 1.5) == (1.0, 20.0)
    assert look_up(table, 0.0) == look_up(table, -3.0) == (0.0, 10.0)
    assert look_up(table, 2.0) == look_up(table, 9.0) == (5.0, 0.0)
    alone = GainTable(1.0, 0.5, ((7.0,),))
    assert look_up(alone, 0.2) == look_up(alone, 3.0) == (7.0,)


@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0, 6.0])
def test_the_turn_is_the_cars_steady_one(speed: float) -> None:
    turning = turn_response(DEFAULT_CAR, speed)
    assert turning.wheel == pytest.approx(feedforward_steer(DEFAULT_CAR, speed, 1.0))
    assert turning.heading == pytest.approx(-steady_slip(DEFAULT_CAR, speed, 1.0))


def test_a_steadily_tightening_turn_leaves_no_offset() -> None:
    speed, rate = 1.5, 0.4
    errors, turning = lane_error_model(DEFAULT_CAR, speed), turn_response(DEFAULT_CAR, speed)
    curvature, h = 0.0, 1e-4
    x = np.array([0.0, 0.0, turning.heading_change * rate, turning.heading * rate])
    for _ in range(20000):
        wheel = turning.wheel * curvature + turning.wheel_change * rate
        x = x + h * (errors.a @ x + errors.b_steer * wheel + errors.b_curvature * curvature)
        curvature += h * rate
    assert abs(x[0]) < 1e-3 * curvature
    assert isinstance(turning, Turning)
