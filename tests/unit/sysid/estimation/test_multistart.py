"""Drives at one speed: other starts, and what is left open where ends differ."""

from dataclasses import replace

import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, wheelbase
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.multistart import candidate_starts, has_one_speed, mark_ambiguous
from steerd.sysid.inference.identifiability import Estimate
from steerd.sysid.inference.plain_car import DEFAULT_FREE

DEFAULT = Model(DEFAULT_CAR)


@pytest.fixture(scope="module")
def slow(make_drive, truth):
    return make_drive(truth, 24.0, 4, speed=1.2)


def test_one_speed_is_distinguished_from_several(slow, make_drive, truth):
    assert has_one_speed([slow])
    assert not has_one_speed([make_drive(truth, 24.0, 4)])


def test_candidate_starts_keep_the_axles_apart_and_what_is_fixed(truth):
    start, *others = candidate_starts(truth, DEFAULT_FREE)
    assert start == truth
    assert len({other.car.lr for other in others}) == 2
    assert len({other.car.steer_delay for other in others}) == 2
    for other in others:
        assert wheelbase(other.car) == pytest.approx(wheelbase(truth.car))
    assert candidate_starts(truth, ("lf", "c_sf", "steer_lag")) == [truth]


def test_what_two_ends_place_differently_is_left_open():
    first = Estimate(0.96, 0.01, 0.3, True)
    found = {"steer_gain": first, "steer_bias": Estimate(0.01, 1e-4, 0.05, True)}

    def other(by):
        return {**found, "steer_gain": replace(first, value=first.value + by * first.sd)}

    assert mark_ambiguous(found, [other(0.1)]) == found
    left = mark_ambiguous(found, [other(0.1), other(3.0)])
    assert not left["steer_gain"].identifiable
    assert left["steer_gain"].sd == pytest.approx(3.0 * first.sd)
    assert "as well" in left["steer_gain"].manoeuvre
    assert left["steer_bias"] == found["steer_bias"]


@pytest.mark.slow
def test_one_speed_tells_no_more_than_it_can(slow, truth):
    outcome = learn(Task((slow,), DEFAULT, wheelbase=0.332), lambda: 0.0)
    for name, row in outcome.free_rows.items():
        if row.identifiable:
            assert abs(row.value - getattr(truth.car, name)) < 4.0 * row.sd, name
