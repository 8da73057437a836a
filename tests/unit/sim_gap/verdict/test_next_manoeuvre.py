"""What a manoeuvre is expected to show: as much as it shows once it is driven."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.verdict.next_manoeuvre import MENU, _on, margin
from steerd.sim_gap.verdict.where import Fits
from steerd.sysid.inference.augmented_car import make_augmented_car
from steerd.sysid.inference.residuals import settled
from steerd.sysid.inference.space import make_space, nuisance_names
from tests.unit.sysid.inference.conftest import NOISE, likelihood_of


def test_a_manoeuvre_is_read_as_drives_are_and_no_surer_for_want_of_noise(drive, base):
    runs = drive("mocap_latency=0.03,marker_offset=0.04", runs=2, seconds=6.0, seed=7)
    likelihood = likelihood_of(make_augmented_car(base, runs), runs)
    predictor, padded = likelihood.predictor, likelihood.predictor.padded
    space = make_space(predictor.augmented, (), ("mocap_latency", "marker_offset"))
    at = settled(likelihood, space, np.array([0.03, 0.04, 0.0]))
    for name in MENU:
        there, point = _on(Fits(likelihood, at, at, NOISE, 1.0, ()), name)
        assert point.at.ratio.max() < 0.05
        assert set(there.predictor.channel.flat) == {0, 1, 2, 3}
    values, seen = predictor.layout.values.copy(), padded.there > 0.0
    values[padded.row[seen]] -= at.linear.error[seen]
    exact = replace(predictor, layout=replace(predictor.layout, values=values))
    given = at, nuisance_names(predictor.augmented, runs), ("mocap_latency", "steer_delay")
    expected = margin(replace(likelihood, predictor=exact), *given)
    assert expected == pytest.approx(margin(likelihood, *given), rel=0.15)
