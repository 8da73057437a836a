"""What an earlier drive learnt: inflated with time, joined with a drive or given up."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.online.tracking import Memory, remember, with_memory
from steerd.sim_gap.online.values import values_of
from steerd.sysid.inference.space import make_space

LEARNT = {"steer_bias": (0.004, 4e-4), "speed_gain": (0.979, 0.001)}


def test_what_was_learnt_widens_each_day_until_the_car_file_says_as_much(learner):
    augmented = learner.augmented
    space = make_space(augmented, ("steer_bias",))
    place, row = (n.index("steer_bias") for n in (space.chart.free, space.chart.names))
    before = abs(space.chart.slopes(space.centre)[row, place]) * space.spread[place]
    for days in (0.0, 1.0, 4.0, 20.0):
        ((value, sd),) = remember(augmented, Memory({"steer_bias": (0.004, 4e-4)}, days)).values()
        assert value == 0.004
        assert sd**2 == pytest.approx(4e-4**2 + 0.01 * days * before**2)
    assert remember(augmented, Memory(LEARNT, 26.0)) == {}
    assert remember(augmented, Memory(LEARNT, -0.01)) == remember(augmented, Memory(LEARNT, 0.0))
    lengths = {"lf": (0.17, 1e-4), "lr": (0.16, 1e-4)}  # and what no car has
    assert remember(augmented, Memory({**lengths, "no.such": (1.0, 0.1)}, 0.0)) == {}


def test_memory_and_drive_are_joined_unless_the_drive_shows_another_car(reference, track):
    place, name = reference.space.chart.free.index("steer_lag"), "steer_lag"
    at = float(reference.space.centre[place])
    sd = float(np.sqrt(track.covariance[place, place]))
    joined = with_memory(reference, track, {name: (at + sd, sd)})
    assert 0.4 * sd < joined.mean[place] < sd
    assert np.sqrt(joined.covariance[place, place]) < 0.8 * sd
    others = [i for i in range(reference.space.nuisance) if i != place]
    np.testing.assert_array_equal(joined.mean[others], track.mean[others])
    for size, kept in ((4.0, True), (4.5, False)):
        joined = with_memory(reference, track, {name: (at + size * sd, sd)})
        assert (joined is not track) == kept
    for nothing in ({}, {"speed_gain": (1.0, 1e-3)}):
        joined = with_memory(reference, track, nothing)
        np.testing.assert_array_equal(joined.information, track.information)
        np.testing.assert_array_equal(joined.pull, track.pull)
        np.testing.assert_array_equal(joined.prior, track.prior)


@pytest.mark.slow
def test_a_second_drive_goes_on_from_the_first_unless_it_contradicts_it(learner, drives, learn):
    samples = drives(27.0)
    known = learn(learner, samples).known
    first = {v.name: v for v in values_of(known)}
    kept = Memory({n: (v.value, v.sd) for n, v in first.items() if v.identifiable}, 0.0)
    again = learn(replace(learner, remembered=remember(learner.augmented, kept)), samples)
    second = {v.name: v for v in values_of(again.known)}
    assert second["speed_gain"].identifiable
    assert second["speed_gain"].sd < first["speed_gain"].sd
    wrong = Memory({"speed_gain": (first["speed_gain"].value + 0.06, 1e-3)}, 0.0)
    cold = learn(replace(learner, remembered=remember(learner.augmented, wrong)), samples)
    np.testing.assert_array_equal(cold.known.track.information, known.track.information)
