"""The check of the closed loop: the measured numbers of the paper's poles, and refusals."""

import numpy as np
import pytest

from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR, Car
from steerd.car_model.path.path_spec import parse_path
from steerd.controller import design
from steerd.controller.build import make_controller
from steerd.controller.config import PAPER_POLES, ControllerConfig
from steerd.controller.gains import design_table, pole_placement_gains
from steerd.controller.loop_model import Timing, pack_gains

BARE: Car[float] = PAPER_CAR._replace(steer_lag=0.0, steer_delay=0.0)
"""The paper's car as its own designs see it: no servo lag, no dead time."""
PAPER = ControllerConfig(design="pole_placement")
CIRCLE = parse_path("circle:radius=2")


def radius_of(rate_hz: float, delay_s: float, speed: float = 1.0) -> float:
    row = pack_gains(pole_placement_gains(BARE, speed, PAPER_POLES), chained=False)
    closed = design.closed_loop(BARE, row, 0, speed, Timing(rate_hz, delay_s, 0.0))
    return design.stability(closed, speed, 1.0 / rate_hz).radius


@pytest.mark.parametrize(
    ("rate_hz", "ticks", "radius"),
    [(100.0, 0, 0.98), (100.0, 1, 1.18), (200.0, 1, 0.99), (50.0, 0, 1.86)],
)
def test_the_papers_poles_at_real_rates(rate_hz, ticks, radius):
    assert radius_of(rate_hz, ticks / rate_hz) == pytest.approx(radius, abs=0.0055)


def test_a_fraction_of_a_tick_lies_between():
    radii = [radius_of(100.0, delay) for delay in (0.0, 0.006, 0.008, 0.009, 0.01)]
    assert radii[0] < 1.0 < radii[2] < radii[3] < radii[4]


def test_the_closed_loop_is_the_loop_run_by_hand():
    """Eigenvalues of the matrix against a simulated loop with fractional delay and lag."""
    config, timing = ControllerConfig(), Timing(100.0, 0.025, 0.05)
    table = design_table(DEFAULT_CAR, config, timing, 1.0)
    real = Timing(100.0, 0.04, 0.08)
    closed = design.closed_loop(DEFAULT_CAR, table.rows[-1], table.pasts, 1.0, real)
    assert closed.shape == (9, 9)  # five states and the four references that are really under way
    x = np.zeros(9)
    x[0] = 1.0
    sizes = []
    for _ in range(3000):
        x = closed @ x
        sizes.append(float(np.linalg.norm(x)))
    measured = (sizes[-1] / sizes[-1001]) ** (1.0 / 1000.0)
    assert design.stability(closed, 1.0, 0.01).radius == pytest.approx(measured, abs=1e-3)


def test_fewer_references_under_way_than_the_design_believes():
    table = design_table(DEFAULT_CAR, ControllerConfig(), Timing(100.0, 0.04, 0.05), 1.0)
    for real in (Timing(100.0, 0.0, 0.05), Timing(100.0, 0.0, 0.0), Timing(100.0, 0.015, 0.05)):
        closed = design.closed_loop(DEFAULT_CAR, table.rows[-1], table.pasts, 1.0, real)
        assert design.stability(closed, 1.0, 0.01).radius < 1.0


def test_damping_is_that_of_the_mode():
    gone_at_once = 0.01 * np.array([[0.0, -1.0], [1.0, 0.0]])
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    both = np.block([[np.exp(-0.1) * turn, np.zeros((2, 2))], [np.zeros((2, 2)), gone_at_once]])
    seen = design.stability(both, 2.0, 0.01)
    assert seen.radius == pytest.approx(np.exp(-0.1))
    assert seen.damping == pytest.approx(0.1 / np.hypot(0.1, 0.3))


def test_the_papers_poles_pass_where_they_are_stable():
    made = make_controller(BARE, CIRCLE, PAPER, 100.0)
    assert max(at.radius for at in made.report.stabilities) < 1.0
    assert "pole_placement, 100 Hz" in made.report.describe()


def test_the_papers_poles_are_refused_with_a_tick_of_delay():
    with pytest.raises(design.DesignRefused) as refused:
        make_controller(BARE, CIRCLE, PAPER, 100.0, 0.01)
    said = str(refused.value)
    for part in ("1.00 m/s", "100 Hz", "10.0 ms dead time", "1.18", "design = 'lqr' (passes)"):
        assert part in said


def test_what_a_refusal_says_passes_does_pass():
    with pytest.raises(design.DesignRefused) as refused:
        make_controller(BARE, CIRCLE, PAPER, 50.0)
    said = str(refused.value)
    assert "100 Hz (passes)" in said
    assert "speed = 0.68 (passes)" in said
    make_controller(BARE, CIRCLE, PAPER, 100.0)
    make_controller(BARE, CIRCLE, ControllerConfig(design="pole_placement", speed=0.68), 50.0)


def test_poles_by_the_cars_own_fast_modes_bear_a_servo():
    midway = ControllerConfig(design="pole_placement", poles=(-2 + 2j, -2 - 2j, -60, -40))
    with pytest.raises(design.DesignRefused, match=r'poles = \["-2-2j", "-2\+2j", "-52'):
        make_controller(DEFAULT_CAR, CIRCLE, midway, 100.0)
    gentle = ControllerConfig(
        design="pole_placement", poles=(-2 - 2j, -2 + 2j, -52.5, -113.1), grid_speed_min=1.0
    )
    assert make_controller(DEFAULT_CAR, CIRCLE, gentle, 100.0).report.delay_margin_s > 0.0


def test_an_ill_damped_design_is_refused():
    ringing = ControllerConfig(
        design="pole_placement", poles=(-1 + 15j, -1 - 15j, -52.6, -93.6), grid_speed_min=1.0
    )
    with pytest.raises(design.DesignRefused, match=r"has damping 0\.0"):
        make_controller(BARE, CIRCLE, ringing, 100.0)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0, 500.0])
@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.04, 0.1])
def test_lqr_passes_at_every_rate_and_delay(rate_hz, delay_s):
    table = design_table(DEFAULT_CAR, ControllerConfig(), Timing(rate_hz, delay_s, 0.05), 1.5)
    for at in design.assess(DEFAULT_CAR, table, Timing(rate_hz, delay_s, 0.05)):
        assert at.radius < 1.0
        assert at.damping > 0.5


def test_the_delay_margin_is_where_the_loop_turns_unstable():
    timing = Timing(100.0, 0.01, 0.05)
    table = design_table(DEFAULT_CAR, ControllerConfig(speed=4.0), timing, 4.0)
    margin = design.delay_margin(DEFAULT_CAR, table, timing)
    assert 0.03 < margin < 0.2
    over = timing._replace(delay_s=timing.delay_s + margin + 0.005)
    inside = timing._replace(delay_s=timing.delay_s + margin)
    radii = {
        late: max(design.stability_at(DEFAULT_CAR, table, v, late).radius for v in table.speeds)
        for late in (inside, over)
    }
    assert radii[inside] < 1.0 <= radii[over]


def test_a_path_tighter_than_the_car_is_refused():
    with pytest.raises(ValueError, match=r"radius 0\.80 m .* wheel angle of -0\.4"):
        make_controller(DEFAULT_CAR, parse_path("circle:radius=-0.8"), ControllerConfig(), 100.0)


@pytest.mark.parametrize(("rate_hz", "delay_s"), [(0.0, 0.0), (100.0, -0.1), (100.0, 3.0)])
def test_senseless_timing_is_refused(rate_hz, delay_s):
    with pytest.raises(ValueError, match="rate"):
        make_controller(DEFAULT_CAR, CIRCLE, ControllerConfig(), rate_hz, delay_s)
