"""Distance from -1 against what it promises: gains and delays that the loop survives."""

from math import asin

import numpy as np
import pytest

from steerd.controller.design import closed_loop, margins, stability_at
from steerd.controller.gain_table import N_LANE, look_up
from steerd.controller.loop_model import sampled_loop
from tests.designs import design_for, scaled, standard

SPEEDS = (0.3, 0.9, 1.5)


@pytest.fixture(scope="module")
def held():
    return standard()


def distance_of(held, table, speed, timing):
    return margins(held.file.car, look_up(table, speed), table.pasts, speed, timing).distance


@pytest.mark.parametrize("factor", [1.0, 2.5])
@pytest.mark.parametrize("speed", SPEEDS)
def test_the_loop_survives_a_servo_as_much_stronger_or_weaker_as_it_says(held, speed, factor):
    """At 100 Hz and 10 ms the wheel follows the reference before the newest, and that alone."""
    table, timing = scaled(design_for(held), factor).table, held.file.report.timing
    row, m = look_up(table, speed), distance_of(held, table, speed, timing)
    assert 0.1 < m < 1.0
    closed = closed_loop(held.file.car, row, table.pasts, speed, timing)
    a, b = sampled_loop(held.file.car, speed, timing)
    assert not b[:N_LANE].any()
    for strength in np.linspace(1.0 / (1.0 + m), 0.98 / (1.0 - m), 15):
        changed = closed.copy()
        changed[:N_LANE, N_LANE:] += (strength - 1.0) * a[:N_LANE, N_LANE:]
        assert np.abs(np.linalg.eigvals(changed)).max() < 1.0 + 1e-9


@pytest.mark.parametrize("speed", SPEEDS)
def test_the_loop_survives_the_delay_that_the_distance_promises_at_its_crossover(held, speed):
    table, timing = design_for(held).table, held.file.report.timing
    phase = 2.0 * asin(0.5 * distance_of(held, table, speed, timing))
    later = timing._replace(delay_s=timing.delay_s + 0.02)
    assert phase > 0.5
    assert stability_at(held.file.car, table, speed, later).radius < 1.0


def test_more_feedback_and_more_delay_bring_it_nearer(held):
    table, timing = design_for(held).table, held.file.report.timing
    later = timing._replace(delay_s=timing.delay_s + 0.06)
    own = distance_of(held, table, 1.5, timing)
    assert distance_of(held, scaled(design_for(held), 3.0, 0, 4).table, 1.5, timing) < own
    assert distance_of(held, table, 1.5, later) < own
