"""A change is named as `diagnose` names a gap, about the car as the drive showed it."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.online.learner import State, fold
from steerd.sim_gap.online.looking import may_change
from steerd.sim_gap.online.naming import EARLY, Finding, believed, find_cause
from steerd.sysid.inference.knowledge import Knowledge
from steerd.sysid.inference.space import make_space

AT = 30.2


def test_what_is_known_of_the_base_is_as_wide_as_its_track_and_no_wider(anchor, track):
    base = believed(anchor, track)
    free = anchor.space.chart.free[: anchor.space.nuisance]
    space = make_space(base, free)
    widened = np.sqrt(np.diag(space.covariance) / np.diag(track.covariance))
    assert (widened >= 1.0 - 1e-6).all()
    np.testing.assert_allclose(space.centre, anchor.space.centre[: len(free)])


def test_the_base_begins_where_its_track_is(anchor, track):
    moved = replace(track, pull=track.information @ np.full(anchor.space.nuisance, 1e-4))
    at = make_space(believed(anchor, moved), anchor.space.chart.free[: anchor.space.nuisance])
    np.testing.assert_allclose(at.centre - anchor.space.centre[: len(at.centre)], 1e-4)


def test_where_healthy_drives_left_more_than_noise_the_base_does_too(anchor, track):
    excess = (1.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    free = anchor.space.chart.free[: anchor.space.nuisance]
    taught = Knowledge(free, track.covariance, excess)
    car = replace(anchor, superset=replace(anchor.superset, knowledge=taught))
    assert believed(car, track).knowledge.excess == excess
    assert believed(anchor, track).knowledge.excess == (1.0,) * len(excess)


def test_windows_that_no_car_drove_say_nothing(anchor, track):
    assert find_cause(anchor, track, ()) == Finding("changed", None)


@pytest.fixture(scope="module")
def healthy(learner, drives):
    state = State()
    for sample in drives(AT):
        state, _ = fold(learner, state, sample)
    return state


@pytest.fixture(scope="module")
def loose(learner, drives):
    state = State()
    for sample in drives(AT + 7.0, "steer_backlash", AT):
        state, _ = fold(learner, state, sample)
    return state


@pytest.mark.slow
def test_healthy_windows_have_no_cause(healthy):
    known, runs = healthy.known, [run for _, run in healthy.windows]
    assert find_cause(known.anchor, known.track, runs) == Finding("none", None)
    few = find_cause(known.anchor, known.track, runs[-EARLY + 1 :])
    assert few == Finding("changed", None), "too early to say so"


@pytest.mark.slow
def test_play_is_named_although_it_has_no_gradient_where_there_is_none(loose):
    cause = loose.change.finding.cause
    assert cause.effect == "steer_backlash"
    value, sd, _ = cause.parameters["play"]
    assert value == pytest.approx(0.03, abs=4.0 * sd)
    assert cause.confidence > 0.8


@pytest.mark.slow
def test_only_what_a_lane_shows_at_once_can_have_come_about(healthy):
    runs = [run for _, run in healthy.windows]
    possible = may_change(healthy.known.anchor.superset, runs)
    assert {"steer_lag", "steer_backlash", "marker_offset"} <= set(possible)
    assert not {"grip_drift", "grip_patch", "battery_sag"} & set(possible)
