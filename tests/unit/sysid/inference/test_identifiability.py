"""What a covariance says of parameters: what is identifiable, and why the rest is not."""

import numpy as np
import pytest

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import parameter_vector
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.planar import make_planar
from steerd.sysid.inference.chart import make_chart
from steerd.sysid.inference.identifiability import estimates, taught_estimates
from steerd.sysid.inference.knowledge import Spread, inflate_each
from steerd.sysid.inference.plain_car import TYRES

CAR = DEFAULT_CAR._replace(lf=0.16, steer_gain=0.95)
SD = {"lf": 0.002, "lr": 0.1, "steer_gain": 0.01, "steer_delay": 0.001, "tyre_saturation.q": 0.1}


def test_noise_that_passes_for_transients_tells_no_compliance():
    """Known to a third of itself, after a start with tyres three times as soft."""
    p = parameter_vector(Model(DEFAULT_CAR._replace(c_sf=3.0)))
    chart = make_chart((), p, TYRES)
    z = chart.coordinates(parameter_vector(Model(DEFAULT_CAR._replace(c_sf=9.0))))
    sd = np.array([1e-5, 1e-5, 0.3 * z[2], 1e-3])
    assert not estimates(chart, z, np.diag(sd**2))["c_sf"].identifiable


def test_nothing_is_told_while_a_length_sits_at_its_bound():
    names = ("lf", "lr", "inertia_z")
    prior = parameter_vector(Model(DEFAULT_CAR))
    chart = make_chart((), prior, names, 0.33)
    small = np.diag([1e-4, 1e-4]) ** 2
    for lr, told in ((0.17, True), (0.325, False)):
        z = chart.coordinates(parameter_vector(Model(DEFAULT_CAR._replace(lr=lr))))
        found = estimates(chart, z, small)
        assert all(e.identifiable is told for e in found.values())
        assert all(("at its bound" in e.manoeuvre) is not told for e in found.values())


def _taught(effects, values, sd):
    model = Model(CAR, effects, values, make_planar("rear"))
    return taught_estimates(effects, parameter_vector(model), sd)


def test_identifiable_is_what_is_known_to_a_few_percent():
    found = _taught((EFFECTS["tyre_saturation"],), ((0.8, 0.0),), SD)
    assert set(found) == set(SD)
    assert (found["lf"].value, found["lf"].sd) == (0.16, 0.002)
    assert found["tyre_saturation.q"].value == 0.8
    assert found["lf"].identifiable
    assert found["lf"].manoeuvre == ""
    assert not found["lr"].identifiable  # 0.1 m of 0.17 m
    assert "speeds" in found["lr"].manoeuvre
    assert found["steer_delay"].identifiable


def test_what_drives_mistake_for_the_bodys_place_is_to_be_weighed():
    effects = (EFFECTS["tyre_saturation"], EFFECTS["marker_offset"])
    sd = {**SD, "lf": 0.02, "marker_offset.forward": 0.02}
    found = _taught(effects, ((0.8, 0.0), (0.02, 0.0)), sd)
    for name in ("lf", "lr", "marker_offset.forward"):
        assert not found[name].identifiable
        assert "weighing both axles" in found[name].manoeuvre
    assert found["steer_gain"].manoeuvre == ""


def test_each_standard_error_is_as_wide_as_its_own_scores_and_correlations_stay():
    """The spread of estimates over many draws, where the noise is not what the fit believes."""
    rng = np.random.default_rng(2)
    design = rng.standard_normal((24, 40, 3))
    loud = np.array([1.0, 1.0, 3.0])[rng.integers(0, 3, 24)]
    information = np.einsum("bri,brj->ij", design, design)
    covariance = np.linalg.inv(information)
    found, wide = [], []
    for _ in range(2000):
        noise = rng.standard_normal((24, 40)) * loud[:, None]
        pulls = np.einsum("bri,br->bi", design, noise)
        found.append(covariance @ pulls.sum(axis=0))
        left = noise - design @ found[-1]
        pulls = np.einsum("bri,br->bi", design, left)
        each = inflate_each(covariance, Spread(pulls.T @ pulls, 24.0))
        wide.append(np.sqrt(np.diag(each)))
    np.testing.assert_allclose(np.median(wide, axis=0), np.std(found, axis=0), rtol=0.15)
    scale, before = np.sqrt(np.diag(each)), np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(before, before)
    np.testing.assert_allclose(each / np.outer(scale, scale), correlation, rtol=1e-9)
    assert (scale >= before * (1.0 - 1e-12)).all()
    assert pytest.approx(np.diag(correlation)) == np.ones(3)
