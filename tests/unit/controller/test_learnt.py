"""The numbers that a controller follows: bounds, steps and what stays the file's."""

import pytest

from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.controller.learnt import (
    OF_CAR,
    Learnt,
    approach_learnt,
    follow_learnt,
    learnt_of,
    make_bounds,
    steps,
)
from tests.designs import design_for, standard

FILE = learnt_of(DEFAULT_CAR)


def test_the_bounds_hold_the_file_and_no_impossible_car():
    low, high = make_bounds(DEFAULT_CAR)
    for name, at, least, most in zip(Learnt._fields, FILE, low, high, strict=True):
        assert least <= at <= most, name
    physical = {p.name: (p.low, p.high) for p in PARAMETERS}
    for name in OF_CAR:
        assert physical[name][0] <= getattr(low, name)
        assert getattr(high, name) <= physical[name][1]
    assert low.steer_delay == 0.0, "no order arrives before it left"


def test_each_step_comes_nearer_and_ends_there():
    bounds, most = make_bounds(DEFAULT_CAR), steps(DEFAULT_CAR)
    aim = FILE._replace(steer_gain=0.88, steer_bias=0.02, steer_delay=0.05)
    at, taken = FILE, 0
    while at != aim:
        before, at = at, approach_learnt(at, aim, bounds, most)
        for name, a, b, far in zip(Learnt._fields, before, at, most, strict=True):
            assert abs(b - a) <= far + 1e-12, name
        taken += 1
        assert taken < 10
    assert taken > 3, "slowly"


def test_an_aim_out_of_bounds_ends_at_the_bound():
    bounds, most = make_bounds(DEFAULT_CAR), steps(DEFAULT_CAR)
    at = FILE
    for _ in range(100):
        at = approach_learnt(at, FILE._replace(steer_gain=0.1), bounds, most)
    assert at.steer_gain == pytest.approx(bounds.low.steer_gain)


def test_what_is_not_followed_stays_the_files():
    held = standard()
    made = follow_learnt(held.file, design_for(held, steer_gain=0.98, steer_delay=0.016))
    same = set(DEFAULT_CAR._fields) - {"steer_gain", "steer_delay"}
    assert all(getattr(made.car, name) == getattr(held.file.car, name) for name in same)
    assert made.config == held.file.config
    assert made.keeper.preview_s == pytest.approx(held.file.keeper.preview_s + 0.006)
    assert made.report.timing.rate_hz == held.file.report.timing.rate_hz
