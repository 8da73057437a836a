"""The filter over parameters: only what the data replace is forgotten."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.online import learner as live
from steerd.sim_gap.online import tracking
from steerd.sim_gap.online.changes import SPANS, QuietRatios, ratios, reweighted
from steerd.sim_gap.online.learner import Change, State
from steerd.sim_gap.online.naming import EARLY, Finding, Known, believed, find_cause
from steerd.sim_gap.online.tracking import Seen, Track, follow, informed_directions, may_change
from steerd.sim_gap.online.values import amounts_of, values_of
from steerd.sysid.inference.augmented_car import BasePrior
from steerd.sysid.inference.space import make_space
from tests.unit.sim_gap.online.conftest import change

PRIOR = np.diag([1.0, 4.0, 0.25])


def known():
    return Track(PRIOR + np.diag([30.0, 90.0, 60.0]), np.array([3.0, -2.0, 1.0]), PRIOR)


def test_a_window_that_tells_nothing_changes_nothing_and_only_a_direction_that_is_told_fades():
    track = after = known()
    for _ in range(5000):
        after = follow(after, np.zeros(3), np.zeros((3, 3)))
    np.testing.assert_allclose(after.information, track.information, rtol=1e-12)
    np.testing.assert_allclose(after.mean, track.mean, rtol=1e-9)
    after, h = track, np.diag([0.0, 0.5, 0.0])
    for _ in range(2000):
        after = follow(after, h @ track.mean, h, memory=100.0)
    np.testing.assert_allclose(after.mean, track.mean, rtol=1e-6)
    assert after.information[0, 0] == pytest.approx(track.information[0, 0])
    assert after.information[2, 2] == pytest.approx(track.information[2, 2])
    settled = PRIOR[1, 1] + 0.5 / (1.0 - np.exp(-0.01))
    assert after.information[1, 1] == pytest.approx(settled, rel=0.01)


def test_a_parameter_that_moved_is_followed_and_its_neighbours_stay():
    track, h = Track(PRIOR + 50.0 * np.eye(3), np.zeros(3), PRIOR), np.diag([2.0, 0.0, 0.0])
    for _ in range(600):
        track = follow(track, h @ np.array([0.3, 0.0, 0.0]), h, memory=60.0)
    assert track.mean[0] == pytest.approx(0.3, rel=0.02)
    np.testing.assert_allclose(track.mean[1:], 0.0, atol=1e-12)


def test_standard_deviations_never_exceed_the_prior():
    track, rng = Track(PRIOR, np.zeros(3), PRIOR), np.random.default_rng(1)
    for _ in range(300):
        slopes = rng.standard_normal((2, 3)) * np.array([1.0, 0.1, 3.0])
        track = follow(track, np.zeros(3), slopes.T @ slopes, memory=20.0)
        assert (np.diag(track.covariance) <= 1.0 / np.diag(PRIOR) + 1e-9).all()
        assert np.linalg.eigvalsh(track.information).min() > 0.0


def test_directions_do_not_depend_on_units():
    h, scale = np.diag([1.0, 1e-4, 0.3]), np.diag([1e3, 1e-2, 1.0])
    plain = informed_directions(h, PRIOR)
    turned = informed_directions(scale @ h @ scale, scale @ PRIOR @ scale)
    assert plain.shape == turned.shape == (3, 2)


# Ratios of the last windows, and what of them a car shows as usual.
def tables(reference, track, looks):
    """Ratios of windows, and the same with weights at the fit."""
    seen = [Seen(track, look) for look in looks]
    table = ratios(reference, seen)
    return table, reweighted(reference, seen, table, np.ones_like(table))


def test_ratios_rise_over_windows_since_a_change_that_something_explains(reference, track, windows):
    looks = [*windows(8), *windows(4, seed=8, steer_bias=0.02)]
    table, _ = tables(reference, track, looks)
    bias = table[reference.space.effects.index("steer_bias")]
    assert int(np.nanargmax(bias)) == SPANS.index(4)
    assert bias[SPANS.index(4)] > 50.0
    assert np.isnan(bias[SPANS.index(16)])
    seen = [Seen(track, look) for look in windows(6)]
    table = ratios(reference, seen)
    assert reweighted(reference, seen, table, np.full_like(table, np.nanmax(table))) is table
    _, after = tables(reference, track, windows(2, left=40.0))
    assert np.nanmax(after) < 20.0


def test_a_plain_change_counts_for_more_than_its_outlying_windows(reference, track, windows):
    table, after = tables(reference, track, windows(2, steer_bias=0.02))
    short, bias = SPANS.index(2), reference.space.effects.index("steer_bias")
    assert after[bias, short] > 1.2 * table[bias, short]
    assert int(np.argmax(after[:, short])) == bias


@pytest.mark.parametrize(("off", "same"), [({"tyre_friction": -0.2}, ""),
                                           ({"steer_bias": 0.9}, "steer_bias")])  # fmt: skip
def test_no_ratio_becomes_smaller_and_none_appears(reference, track, windows, off, same):
    """A value that no car has sharpens nothing."""
    table, after = tables(reference, track, windows(4, **off))
    np.testing.assert_array_equal(np.isnan(table), np.isnan(after))
    there = np.isfinite(table)
    assert (after[there] >= table[there]).all()
    for row in [reference.space.effects.index(same)] if same else []:
        np.testing.assert_array_equal(table[row], after[row])


def test_what_was_followed_since_a_change_is_taken_back(
    learner, reference, track, windows, monkeypatch
):
    usual = QuietRatios(*np.zeros((3, len(reference.space.effects), len(SPANS))))
    state = State(known=Known(reference, track, usual))
    monkeypatch.setattr(live, "judge", lambda known, change: change)
    monkeypatch.setattr(tracking, "look", lambda reference, run, t: run)
    for seen in [*windows(10), *windows(12, seed=8, steer_bias=0.0085)]:
        state = state if state.change else live.take_window(learner, state, seen.t, seen)
    assert (state.known.track is state.change.before, state.known.shown) == (True, ())


def test_what_a_car_shows_as_usual_is_no_change():
    shape = (2, len(SPANS))
    loud = quiet = QuietRatios(*np.zeros((3, *shape)))
    for _ in range(200):
        loud, quiet = loud.after(np.full(shape, 9.0)), quiet.after(np.full(shape, 0.3))
    assert (loud.level() > 8.0).all()
    assert (quiet.level() < 2.0).all()


# What is told of a change is by how much the car moved, whatever it was learnt to have before.
@pytest.mark.parametrize(("effect", "after", "was", "moved"), [
    ("marker_offset", (0.018, 0.001), (-0.0115, 0.0004),
     [(0.0295, 0.5, "m"), (0.0006, 0.5, "m")]),
    ("speed_scale", (0.76,), (0.8,), [(0.95, 0.625, "1")]),  # of a ratio the quotient
    ("lateral_load_transfer", (0.5, 0.7), (0.2, 0.62),
     [(0.3, 0.5, "1"), (0.7, 0.5, "1")]),  # the form is no amount
])  # fmt: skip
def test_an_effect_moved_by_a_difference_or_a_quotient(effect, after, was, moved):
    amounts = amounts_of(change(effect, *after, was=was, sd=0.5)).values()
    assert [unit for _, _, unit in amounts] == [unit for _, _, unit in moved]
    assert [each[:2] for each in amounts] == [pytest.approx(each[:2]) for each in moved]
    assert amounts_of(Change(0.0, 1.0, None, ())) == {}, "without a name"


# A change is named as `diagnose` names a gap, about the car as the drive showed it.
AT = 30.2


def test_the_base_is_known_as_its_track_says_and_no_better(reference, track):
    """What healthy drives left or ruled out, its windows leave and rule out too."""
    n, ruled_out = reference.space.nuisance, {"accel_max": 3.0}
    names = reference.space.chart.free[:n]
    fitted = BasePrior(names, track.covariance, size=0.4, least=ruled_out)
    car = replace(reference, augmented=replace(reference.augmented, knowledge=fitted))
    moved = replace(track, pull=track.information @ np.full(n, 1e-4))
    base = believed(car, moved)
    space = make_space(base, reference.space.chart.free[:n])
    widened = np.sqrt(np.diag(space.covariance) / np.diag(track.covariance))
    assert (widened >= 1.0 - 1e-6).all()
    np.testing.assert_allclose(space.centre - reference.space.centre[:n], 1e-4)
    assert (base.knowledge.size, base.knowledge.least) == (0.4, ruled_out)
    unknown = believed(reference, track).knowledge
    assert (unknown.size, unknown.least) == (0.0, {})


def test_windows_that_no_car_drove_say_nothing(reference, track):
    assert find_cause(reference, track, ()) == Finding("changed", None)


healthy = pytest.fixture(lambda learner, drives, learn: learn(learner, drives(AT)), scope="module")


@pytest.mark.slow
def test_healthy_windows_have_no_cause_and_only_what_a_lane_shows_at_once_can_come_about(healthy):
    known, runs = healthy.known, [run for _, run in healthy.windows]
    assert find_cause(known.reference, known.track, runs) == Finding("none", None)
    few = find_cause(known.reference, known.track, runs[-EARLY + 1 :])
    assert few == Finding("changed", None), "too early to say so"
    possible = may_change(known.reference.augmented, runs)
    assert {"steer_lag", "steer_backlash", "marker_offset"} <= set(possible)
    assert not {"grip_drift", "grip_patch", "battery_sag"} & set(possible)


# What an earlier drive learnt: inflated with time, joined with a drive or given up.
LEARNT = {"steer_bias": (0.004, 4e-4), "speed_gain": (0.979, 0.001)}


def test_what_was_learnt_widens_each_day_until_the_car_file_says_as_much(learner):
    augmented = learner.augmented

    def remembered(values, days):
        return tracking.remember(augmented, tracking.Memory(values, days))

    space = make_space(augmented, ("steer_bias",))
    place, row = (n.index("steer_bias") for n in (space.chart.free, space.chart.names))
    before = abs(space.chart.slopes(space.centre)[row, place]) * space.spread[place]
    for days in (0.0, 1.0, 4.0, 20.0):
        ((value, sd),) = remembered({"steer_bias": (0.004, 4e-4)}, days).values()
        assert value == 0.004
        assert sd**2 == pytest.approx(4e-4**2 + 0.01 * days * before**2)
    assert remembered(LEARNT, 26.0) == {}
    assert remembered(LEARNT, -0.01) == remembered(LEARNT, 0.0)
    lengths = {"lf": (0.17, 1e-4), "lr": (0.16, 1e-4)}  # and what no car has
    assert remembered({**lengths, "no.such": (1.0, 0.1)}, 0.0) == {}


def test_memory_and_drive_are_joined_unless_the_drive_shows_another_car(reference, track):
    place, name = reference.space.chart.free.index("steer_lag"), "steer_lag"
    at = float(reference.space.centre[place])
    sd = float(np.sqrt(track.covariance[place, place]))
    joined = tracking.with_memory(reference, track, {name: (at + sd, sd)})
    assert 0.4 * sd < joined.mean[place] < sd
    assert np.sqrt(joined.covariance[place, place]) < 0.8 * sd
    others = [i for i in range(reference.space.nuisance) if i != place]
    np.testing.assert_array_equal(joined.mean[others], track.mean[others])
    for size, kept in ((4.0, True), (4.5, False)):
        joined = tracking.with_memory(reference, track, {name: (at + size * sd, sd)})
        assert (joined is not track) == kept
    for nothing in ({}, {"speed_gain": (1.0, 1e-3)}):
        joined = tracking.with_memory(reference, track, nothing)
        np.testing.assert_array_equal(joined.information, track.information)
        np.testing.assert_array_equal(joined.pull, track.pull)
        np.testing.assert_array_equal(joined.prior, track.prior)


@pytest.mark.slow
def test_a_second_drive_goes_on_from_the_first_unless_it_contradicts_it(learner, drives, learn):
    samples = drives(27.0)
    known = learn(learner, samples).known
    first = {v.name: v for v in values_of(known)}
    kept = tracking.Memory({n: (v.value, v.sd) for n, v in first.items() if v.identifiable}, 0.0)
    again = learn(replace(learner, remembered=tracking.remember(learner.augmented, kept)), samples)
    second = {v.name: v for v in values_of(again.known)}
    assert second["speed_gain"].identifiable
    assert second["speed_gain"].sd < first["speed_gain"].sd
    wrong = tracking.Memory({"speed_gain": (first["speed_gain"].value + 0.06, 1e-3)}, 0.0)
    cold = learn(replace(learner, remembered=tracking.remember(learner.augmented, wrong)), samples)
    np.testing.assert_array_equal(cold.known.track.information, known.track.information)
