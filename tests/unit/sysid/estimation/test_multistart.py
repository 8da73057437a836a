"""Drives at one speed: other starts, and what is left open where ends differ."""

from dataclasses import replace

import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, wheelbase
from steerd.sysid.estimation.fit import DEFAULT_FREE, Options, fit
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.multistart import (
    COMPARABLE,
    candidate_starts,
    has_one_speed,
    log_cost,
    mark_ambiguous,
)

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


def test_what_two_ends_place_differently_is_left_open(slow):
    found = fit([slow], DEFAULT, options=Options(free=("steer_gain", "steer_bias")))
    first = found.estimates["steer_gain"]
    far = replace(first, value=first.value + 3.0 * first.sd)
    near = replace(first, value=first.value + 0.1 * first.sd)

    def other(moved):
        return replace(found, estimates={**found.estimates, "steer_gain": moved})

    assert mark_ambiguous(found, [other(near)]).estimates == found.estimates
    left = mark_ambiguous(found, [other(near), other(far)]).estimates
    assert not left["steer_gain"].identifiable
    assert left["steer_gain"].sd == pytest.approx(3.0 * first.sd)
    assert "as well" in left["steer_gain"].manoeuvre
    assert left["steer_bias"] == found.estimates["steer_bias"]


@pytest.mark.slow
def test_the_best_end_is_taken_at_one_speed_and_the_others_asked(
    slow, make_drive, truth, monkeypatch
):
    seen = []

    def ask(best, others):
        seen.append((log_cost(best), [log_cost(other) for other in others]))
        return mark_ambiguous(best, others)

    monkeypatch.setattr("steerd.sysid.estimation.learn.mark_ambiguous", ask)
    options = Options(wheelbase=0.332)
    learn(Task((slow,), DEFAULT, options=options), lambda: 0.0)
    (best, others), *more = seen
    assert others
    assert all(best <= other < best + COMPARABLE for other in others)
    learn(Task((make_drive(truth, 24.0, 4),), DEFAULT, options=options), lambda: 0.0)
    assert not more
    assert len(seen) == 1
