"""A hundred thousand random and hostile proposals: none that is taken is unstable.

Judged on a finer grid of speeds than the check's own, on the car as proposed and on that of the
file. Most proposals are refused by their numbers; every 500th is a real design, bent a little, that
goes through the whole check.
"""

from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest

from steerd.controller.design import assessed_speeds, stability_at
from steerd.controller.gain_table import GainTable
from steerd.controller.lane_controller import LaneController
from steerd.controller.learnt import Design, Learnt
from tests.designs import accept, design_for, standard

pytestmark = pytest.mark.slow
MANY, WHOLE = 100_000, 500
BASES = ({}, {"steer_gain": 0.98, "steer_delay": 0.016}, {"steer_bias": 0.005, "c_sr": 5.1})


def hostile(rng: np.random.Generator, base: Design) -> Design:
    """Something of a design broken in a way that its sender may have meant."""
    car, table = list(base.car), base.table
    kind = int(rng.integers(5))
    if kind == 0:
        car[rng.integers(len(car))] = float(rng.choice([nan, inf, -inf, 1e300, -1.0, 5.0]))
    elif kind == 1:
        car = (np.array(car) + rng.normal(0.0, 0.3, len(car))).tolist()
    elif kind == 2:
        rows = tuple(tuple(rng.normal(0.0, 1e3, len(row)).tolist()) for row in table.rows)
        table = table._replace(rows=rows)
    elif kind == 3:
        table = GainTable(float(rng.normal()), float(rng.normal()), table.rows)
    else:
        rows = [list(row) for row in table.rows]
        row = rows[rng.integers(len(rows))]
        row[rng.integers(len(row))] = float(rng.choice([nan, inf, 1e5, -1e12]))
        table = table._replace(rows=tuple(map(tuple, rows)))
    return Design(Learnt(*car), table)


def bent(rng: np.random.Generator, base: Design) -> Design:
    """A real design, its gains and numbers off by up to a lot; its turns are those of its car."""
    share = 10.0 ** rng.uniform(-2.0, 0.7)
    factors = 1.0 + share * rng.normal(0.0, 1.0, len(base.table.rows[0]))
    factors[-4:] = 1.0
    rows = tuple(tuple((np.array(row) * factors).tolist()) for row in base.table.rows)
    return base._replace(table=base.table._replace(rows=rows))


def worst_radius(car, table, timing):
    coarse = assessed_speeds(table)
    fine = [
        low + share * (high - low) for low, high in pairwise(coarse) for share in (0.0, 0.4, 0.8)
    ]
    return max(stability_at(car, table, speed, timing).radius for speed in fine)


def test_no_unstable_design_is_taken():
    held = standard()
    bases = [design_for(held, **changed) for changed in BASES]
    rng, taken = np.random.default_rng(20261122), []
    for k in range(MANY):
        base = bases[int(rng.integers(len(bases)))]
        design = hostile(rng, base) if k % WHOLE else bent(rng, base)
        answer = accept(held, bases[0].car, design)
        if isinstance(answer, LaneController):
            taken.append(answer)
    assert len(taken) > MANY // WHOLE // 20, "or the check is never put to the test"
    assert len(taken) < 0.05 * MANY
    for controller in taken[:: max(1, len(taken) // 15)]:
        assert worst_radius(controller.car, controller.table, controller.report.timing) < 1.0
        assert worst_radius(held.file.car, controller.table, held.file.report.timing) < 1.0
