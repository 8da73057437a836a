"""The designs against what they promise, the table's lookup, the check of the closed loop."""

import re
from itertools import product

import numpy as np
import pytest
from control import dlqr  # noqa: TID251

from steerd.car_model.linear import lane_error_model
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR, Car
from steerd.car_model.path.path_spec import parse_path
from steerd.controller import design
from steerd.controller.build import make_controller
from steerd.controller.config import PAPER_POLES, LqrWeights, load_controller_config
from steerd.controller.config import ControllerConfig as Config
from steerd.controller.gain_table import N_LANE, GainTable, look_up
from steerd.controller.gains import design_table, lqr_gains, pole_placement_gains
from steerd.controller.loop_model import Timing, pack_gains, sampled_loop, turn_response
from tests.designs import design_for, scaled, standard
from tests.textbook import feedforward_steer, steady_slip

TIMING = Timing(rate_hz=100.0, delay_s=0.025, lag_s=0.05)
LOOPS = [Timing(*loop) for loop in product((50.0, 500.0), (0.0, 0.05), (0.0, 0.05))]


@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0])
def test_pole_placement_puts_the_continuous_poles(speed):
    errors = lane_error_model(PAPER_CAR, speed)
    gains = pole_placement_gains(PAPER_CAR, speed, PAPER_POLES)
    poles = np.linalg.eigvals(errors.a - errors.b_steer[:, None] @ gains)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(PAPER_POLES), rtol=1e-6)


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


@pytest.mark.parametrize("timing", LOOPS, ids=str)
def test_lqr_has_the_gains_of_python_control(timing):
    weights, lane = LqrWeights(), 5 if timing.lagging else 4
    for speed in (0.1, 1.0, 4.0):
        a, b = sampled_loop(DEFAULT_CAR, speed, timing)
        cost = np.diag([*weights[:lane], *np.zeros(len(a) - lane)])
        expected, _, _ = dlqr(a, b, cost, [[weights.effort]])
        np.testing.assert_array_equal(lqr_gains(DEFAULT_CAR, speed, timing, weights), expected)


def test_lqr_is_the_cheapest_of_its_neighbours_and_without_lag_feeds_back_lane_errors_alone():
    weights = LqrWeights()
    best = lqr_gains(DEFAULT_CAR, 1.0, TIMING, weights)
    assert best.shape == (1, 5 + 3)  # 25 ms at 100 Hz: three references under way
    lowest = cost_of(best, weights)
    for off in np.random.default_rng(1).standard_normal((10, *best.shape)):
        assert cost_of(best * (1.0 + 0.05 * off), weights) > lowest
    table = design_table(DEFAULT_CAR, Config(), Timing(100.0, 0.0, 0.0), 1.0)
    assert table.pasts == 0
    assert all(row[4] == 0.0 for row in table.rows)


def test_the_table_spans_the_speeds_linearly_between_and_holds_outside():
    table = design_table(DEFAULT_CAR, Config(), TIMING, 1.6)
    assert (table.speeds[0], table.speeds[-1]) == (0.1, pytest.approx(1.6))
    assert table.spacing <= 0.25
    assert table.pasts == 3
    assert design_table(DEFAULT_CAR, Config(), TIMING, 0.05).speeds == (0.1,)
    by_poles = Config(design="pole_placement")
    assert design_table(DEFAULT_CAR, by_poles, TIMING, 1.0).speeds[0] == 0.5
    late = Timing(100.0, 0.04, 0.08)
    closed = design.closed_loop(DEFAULT_CAR, table.rows[-1], table.pasts, 1.0, late)
    assert closed.shape == (9, 9)  # five states and the four references that are really under way
    table = GainTable(1.0, 0.5, ((0.0, 10.0), (1.0, 20.0), (5.0, 0.0)))
    assert (look_up(table, 1.25), look_up(table, 1.5)) == ((0.5, 15.0), (1.0, 20.0))
    assert look_up(table, 0.0) == look_up(table, -3.0) == (0.0, 10.0)
    assert look_up(table, 2.0) == look_up(table, 9.0) == (5.0, 0.0)
    alone = GainTable(1.0, 0.5, ((7.0,),))
    assert look_up(alone, 0.2) == look_up(alone, 3.0) == (7.0,)


@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0, 6.0])
def test_the_turn_is_the_cars_steady_one(speed):
    turning = turn_response(DEFAULT_CAR, speed)
    assert turning.wheel == pytest.approx(feedforward_steer(DEFAULT_CAR, speed, 1.0))
    assert turning.heading == pytest.approx(-steady_slip(DEFAULT_CAR, speed, 1.0))


def test_a_steadily_tightening_turn_leaves_no_offset():
    speed, rate = 1.5, 0.4
    errors, turning = lane_error_model(DEFAULT_CAR, speed), turn_response(DEFAULT_CAR, speed)
    curvature, h = 0.0, 1e-4
    x = np.array([0.0, 0.0, turning.heading_change * rate, turning.heading * rate])
    for _ in range(20000):
        wheel = turning.wheel * curvature + turning.wheel_change * rate
        x = x + h * (errors.a @ x + errors.b_steer * wheel + errors.b_curvature * curvature)
        curvature += h * rate
    assert abs(x[0]) < 1e-3 * curvature


# Distance from -1 against what it promises: gains and delays that the loop survives.
held = pytest.fixture(lambda: standard(), scope="module")


@pytest.mark.parametrize("factor", [1.0, 2.5])
@pytest.mark.parametrize("speed", [0.3, 0.9, 1.5])
def test_the_loop_survives_a_servo_as_much_stronger_or_weaker_as_it_says(held, speed, factor):
    """At 100 Hz and 10 ms the wheel follows the reference before the newest, and that alone."""
    table, timing = scaled(design_for(held), factor).table, held.file.report.timing
    row = look_up(table, speed)
    m = design.margins(held.file.car, row, table.pasts, speed, timing)[1]
    assert 0.1 < m < 1.0
    closed = design.closed_loop(held.file.car, row, table.pasts, speed, timing)
    a, b = sampled_loop(held.file.car, speed, timing)
    assert not b[:N_LANE].any()
    for strength in np.linspace(1.0 / (1.0 + m), 0.98 / (1.0 - m), 15):
        changed = closed.copy()
        changed[:N_LANE, N_LANE:] += (strength - 1.0) * a[:N_LANE, N_LANE:]
        assert np.abs(np.linalg.eigvals(changed)).max() < 1.0 + 1e-9


# Settings: defaults, forms of poles, and what a wrong one reports.
def test_a_whole_table():
    config = load_controller_config({
        "design": "pole_placement", "poles": ["-3 + 1j", [-3, -1], -90, "-50"],
        "weights": {"e1": 9, "effort": 2.0}, "speed": 2, "file_speeds": False,
    })  # fmt: skip
    assert config.poles == (-3 + 1j, -3 - 1j, -90, -50)
    assert (config.weights, config.speed) == (LqrWeights(e1=9.0, effort=2.0), 2.0)
    assert not config.file_speeds


@pytest.mark.parametrize(("table", "said"), [
    ({"desing": "lqr"}, "did you mean design"), ({"xyz": 1}, "known are"),
    ({"design": "mpc"}, "use lqr or pole_placement"), ({"design": 3}, "must be a str"),
    ({"file_speeds": 1}, "must be a bool"), ({"speed": "fast"}, "must be a number"),
    ({"speed": True}, "must be a number"), ({"speed": 0.0}, "must be positive"),
    ({"speed": float("nan")}, "must be positive"), ({"speed": 300}, "above"),
    ({"damping_min": 1.0}, "damping_min"), ({"grid_spacing": 1e-9}, "grid_spacing"),
    ({"weights": {"e2_rat": 1.0}}, "did you mean e2_rate"), ({"weights": 4}, "must be a table"),
    ({"weights": {"effort": 0.0}}, "must be positive"), ({"weights": {"e2": -1.0}}, "weights.e2"),
    ({"poles": "-2"}, "must be a list"), ({"poles": ["-2", "-3"]}, "four states"),
    ({"poles": ["-2", "-3", "-4", "x"]}, "is no pole"),
    ({"poles": [-2, -3, -4, 5]}, "negative real part"),
    ({"poles": ["-2+2j", "-2", "-3", "-4"]}, "conjugate pairs"),
])  # fmt: skip
def test_a_wrong_setting_is_named_with_its_problem(table, said):
    with pytest.raises(ValueError, match=said):
        load_controller_config(table)


# The check of the closed loop: the measured numbers of the paper's poles, and refusals.
BARE: Car[float] = PAPER_CAR._replace(steer_lag=0.0, steer_delay=0.0)
"""The paper's car as its own designs see it: no servo lag, no dead time."""
PAPER = Config(design="pole_placement")
CIRCLE = parse_path("circle:radius=2")


@pytest.mark.parametrize(("rate_hz", "ticks", "radius"), [
    (100.0, 0, 0.98), (100.0, 1, 1.18), (200.0, 1, 0.99), (50.0, 0, 1.86),
])  # fmt: skip
def test_the_papers_poles_at_real_rates(rate_hz, ticks, radius):
    row = pack_gains(pole_placement_gains(BARE, 1.0, PAPER_POLES), chained=False)
    closed = design.closed_loop(BARE, row, 0, 1.0, Timing(rate_hz, ticks / rate_hz, 0.0))
    found = design.stability(closed, 1.0, 1.0 / rate_hz).radius
    assert found == pytest.approx(radius, abs=0.0055)


def by_poles(*poles, **more):
    return Config(design="pole_placement", poles=poles, **more)


@pytest.mark.parametrize(("car", "path", "config", "rate_hz", "said"), [
    (BARE._replace(steer_delay=0.01), CIRCLE, PAPER, 100.0,
     ("1.00 m/s", "100 Hz", "10.0 ms dead time", "1.18", "design = 'lqr' (passes)")),
    (BARE, CIRCLE, PAPER, 50.0, ("100 Hz (passes)", "speed = 0.68 (passes)")),
    (BARE, CIRCLE, by_poles(-1 + 15j, -1 - 15j, -52.6, -93.6, grid_speed_min=1.0), 100.0,
     ("has damping 0.0",)),
    (DEFAULT_CAR, CIRCLE, by_poles(-2 + 2j, -2 - 2j, -60, -40), 100.0,
     ('poles = ["-2-2j", "-2+2j", "-52',)),
    (PAPER_CAR, CIRCLE, by_poles(-2, -2, -2, -2), 100.0, ("pole_placement at ",)),
    (DEFAULT_CAR, parse_path("circle:radius=-0.8"), Config(), 100.0,
     ("radius 0.80 m", "wheel angle of -0.4")),
    *((DEFAULT_CAR._replace(steer_delay=delay), CIRCLE, Config(), rate_hz, ("rate",))
      for rate_hz, delay in ((0.0, 0.0), (100.0, -0.1), (100.0, 3.0))),
], ids=["a tick of delay", "half the rate", "ill damped", "poles between", "poles that cannot be",
        "too tight a path", "no rate", "negative delay", "seconds of delay"])  # fmt: skip
def test_a_refusal_says_why_and_what_would_pass(car, path, config, rate_hz, said):
    with pytest.raises(ValueError, match=re.escape(said[0])) as refused:
        make_controller(car, path, config, rate_hz)
    assert all(part in str(refused.value) for part in said), refused.value


def test_what_a_refusal_says_passes_does_pass():
    made = make_controller(BARE, CIRCLE, PAPER, 100.0)
    assert "pole_placement, 100 Hz" in made.report.describe()
    make_controller(BARE, CIRCLE, Config(design="pole_placement", speed=0.68), 50.0)
    gentle = by_poles(-2 - 2j, -2 + 2j, -52.5, -113.1, grid_speed_min=1.0)
    assert make_controller(DEFAULT_CAR, CIRCLE, gentle, 100.0).report.delay_margin_s > 0.0


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0, 500.0])
@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.04, 0.1])
def test_lqr_passes_at_every_rate_and_delay(rate_hz, delay_s):
    timing = Timing(rate_hz, delay_s, 0.05)
    table = design_table(DEFAULT_CAR, Config(), timing, 1.5)
    for at in design.assess(DEFAULT_CAR, table, timing):
        assert at.radius < 1.0
        assert at.damping > 0.5


def test_the_delay_margin_is_where_the_loop_turns_unstable():
    timing = Timing(100.0, 0.01, 0.05)
    table = design_table(DEFAULT_CAR, Config(speed=4.0), timing, 4.0)
    margin = design.delay_margin(DEFAULT_CAR, table, timing)
    assert 0.03 < margin < 0.2
    inside, over = (
        max(design.stability_at(DEFAULT_CAR, table, v, late).radius for v in table.speeds)
        for late in (timing._replace(delay_s=0.01 + margin + more) for more in (0.0, 0.005))
    )
    assert inside < 1.0 <= over
