"""Which designs of the learner may be taken, and which never."""

from math import inf, nan

import pytest

from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.controller import learnt
from steerd.controller.lane_controller import LaneController
from tests.designs import accept, design_for, numbers, scaled, standard

NEAR = {"steer_gain": 0.98, "steer_bias": 0.004, "steer_delay": 0.016}

held = pytest.fixture(lambda: standard(), scope="module")


def refusal(held, at, design):
    refused = accept(held, at, design)
    assert isinstance(refused, str)
    return refused


@pytest.mark.parametrize("changed", [
    NEAR, {"steer_lag": 0.058}, {"speed_gain": 0.985}, {"c_sf": 4.4, "c_sr": 5.7},
    {"body_yaw": 0.006, "body_forward": -0.007},
])  # fmt: skip
def test_a_design_for_a_car_nearby_is_taken(held, changed):
    taken = accept(held, numbers(held), design_for(held, **changed))
    assert isinstance(taken, LaneController), taken
    assert taken.table == design_for(held, **changed).table
    mine, files = taken.keeper, held.file.keeper
    assert (mine.wheel_min, mine.wheel_max) == (files.wheel_min, files.wheel_max)
    assert taken.profile == held.file.profile, "no speed is the learner's"


@pytest.mark.parametrize(("changed", "why"), [
    ({"steer_gain": 0.9}, "too far"), ({"steer_bias": 0.02}, "too far"),
    ({"steer_gain": nan}, "not within"), ({"speed_gain": inf}, "not within"),
    ({"steer_delay": -0.01}, "not within"), ({"body_left": -0.2}, "not within"),
])  # fmt: skip
def test_numbers_out_of_reach_are_refused(held, changed, why):
    design = design_for(held)._replace(car=numbers(held, **changed))
    refused = refusal(held, numbers(held), design)
    assert why in refused
    assert next(iter(changed)) in refused


def test_a_table_of_another_form_is_refused(held):
    good = design_for(held, **NEAR)
    rows = good.table.rows
    bad = {
        "speeds": good.table._replace(speed_min=0.2),
        "as many": good.table._replace(rows=tuple(row[1:] for row in rows)),
        "no number": good.table._replace(rows=((nan, *rows[0][1:]), *rows[1:])),
        "absurd": good.table._replace(rows=((1e6, *rows[0][1:]), *rows[1:])),
        "another car": good.table._replace(rows=tuple((*row[:-4], 2.0, *row[-3:]) for row in rows)),
    }
    for why, table in bad.items():
        assert why in refusal(held, numbers(held), good._replace(table=table))


@pytest.mark.parametrize("factor", [-1.0, 0.0, 30.0])
def test_an_unstable_or_undamped_loop_is_refused(held, factor):
    refused = refusal(held, numbers(held), scaled(design_for(held, **NEAR), factor))
    assert "unstable" in refused or "margin" in refused


def test_a_loop_that_the_files_car_would_not_survive_is_refused(held):
    """For the car as proposed it is fine; whoever proposes may be wrong about that."""
    claimed = {"steer_delay": 0.11, "steer_lag": 0.13, "c_sf": 7.5, "c_sr": 2.2}
    design = scaled(design_for(held, **claimed), -1.0, 5, -4)
    refusal(held, design.car, design)


# The numbers that a controller follows: bounds, steps and what stays the file's.
FILE = learnt.learnt_of(DEFAULT_CAR)


def test_the_bounds_hold_the_file_and_no_impossible_car():
    low, high = learnt.make_bounds(DEFAULT_CAR)
    for name, at, least, most in zip(learnt.Learnt._fields, FILE, low, high, strict=True):
        assert least <= at <= most, name
    physical = {p.name: (p.low, p.high) for p in PARAMETERS}
    for name in learnt.OF_CAR:
        assert physical[name][0] <= getattr(low, name)
        assert getattr(high, name) <= physical[name][1]
    assert low.steer_delay == 0.0, "no order arrives before it left"


def test_each_step_comes_nearer_and_ends_there():
    bounds, most = learnt.make_bounds(DEFAULT_CAR), learnt.steps(DEFAULT_CAR)
    aim = FILE._replace(steer_gain=0.88, steer_bias=0.02, steer_delay=0.05)
    at, taken = FILE, 0
    while at != aim:
        before, at = at, learnt.approach_learnt(at, aim, bounds, most)
        for name, a, b, far in zip(learnt.Learnt._fields, before, at, most, strict=True):
            assert abs(b - a) <= far + 1e-12, name
        taken += 1
        assert taken < 10
    assert taken > 3, "slowly"


def test_what_is_not_followed_stays_the_files(held):
    made = learnt.follow_learnt(held.file, design_for(held, steer_gain=0.98, steer_delay=0.016))
    same = set(DEFAULT_CAR._fields) - {"steer_gain", "steer_delay"}
    assert all(getattr(made.car, name) == getattr(held.file.car, name) for name in same)
    assert made.config == held.file.config
    assert made.keeper.preview_s == pytest.approx(held.file.keeper.preview_s + 0.006)
    assert made.report.timing.rate_hz == held.file.report.timing.rate_hz
