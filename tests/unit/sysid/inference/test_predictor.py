"""Windows of a session: readings, derivatives, hidden pushes and noise."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sysid.data.windows import SPACING
from steerd.sysid.inference import noise as noises
from steerd.sysid.inference.augmented_car import make_augmented_car
from steerd.sysid.inference.constants import NOISE_KEPT
from steerd.sysid.inference.disturbance_response import INPUTS, responses
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.predictor import WILD
from steerd.sysid.inference.residuals import blocks_of, folds_of, robust_mean, settled
from steerd.sysid.inference.search import minimise, stand
from steerd.sysid.inference.space import informative_effects, make_space, nuisance_names


@pytest.fixture(scope="module")
def fitted(likelihood, drive):
    healthy = likelihood.predictor
    space = make_space(healthy.augmented, nuisance_names(healthy.augmented, drive("", 1, 4.0)))
    return minimise(likelihood, stand(likelihood, space, space.centre, healthy.guess, 1.0))


def test_readings_are_thinned_neighbouring_windows_are_a_block_and_folds_take_turns(healthy):
    layout = healthy.layout
    for w in range(layout.count):
        rows = layout.rows(w)
        t = layout.row_t[rows][layout.channel[rows] == 0]
        assert np.all(np.abs(np.diff(t) - SPACING) < 0.011)
        assert len(t) >= 20
    blocks, folds = blocks_of(healthy), folds_of(healthy)
    assert len(np.unique(blocks)) >= 4
    assert set(folds.tolist()) == {0, 1, 2, 3}
    run = healthy.layout.run
    assert all(len(np.unique(run[blocks == b])) == 1 for b in np.unique(blocks))


def test_a_window_that_multiplies_changes_a_thousandfold_keeps_its_error_and_pulls_at_nothing(
    healthy,
):
    """Squares of such derivatives leave no digits: a curvature would come out negative."""
    space, p = make_space(healthy.augmented, ("c_sr",)), healthy.augmented.base.copy()
    p[healthy.augmented.kernels.names.index("c_sr")] = 0.1
    at = healthy.linear(space, space.chart.coordinates(p), healthy.guess)
    error, finite = healthy.errors(p, healthy.guess)
    steep = (at.by_z == 0.0).all(axis=(1, 2))
    assert (finite, at.finite) == (True, True)
    assert 0 < steep.sum() < len(steep)
    assert at.error == pytest.approx(error, rel=1e-6, abs=1e-9)
    assert (at.by_x[steep] == 0.0).all()
    assert max(np.abs(at.by_z).max(), np.abs(at.by_x).max()) < WILD


@pytest.mark.parametrize(("effect", "values"), [
    ("steer_delay", (0.0134,)), ("steer_backlash", (0.02,)), ("steer_rate_limit", (1.5,)),
    ("tyre_relaxation", (0.03,)), ("mocap_latency", (0.021,)), ("marker_offset", (0.02, 0.01)),
    ("grip_drift", (0.3, 1.0)),
])  # fmt: skip
def test_readings_without_derivatives_are_the_same_numbers(healthy, effect, values):
    space, z = make_space(healthy.augmented, (), [effect]), np.array(values)
    x = healthy.guess.copy()
    x[:, 6] = 0.002
    alone, finite = healthy.errors(space.chart.parameters(z), x)
    assert finite
    assert np.abs(alone - healthy.linear(space, z, x).error).max() < 1e-12


def test_a_place_is_as_likely_wherever_the_floor_has_its_origin(drive, base):
    (run,), away = drive("", runs=1, seconds=4.0), [40.0, -25.0, 0.0]
    moved = replace(run, pose=run.pose._replace(values=run.pose.values + away))
    cars = (make_augmented_car(base, [each]) for each in (run, moved))
    here, there = (make_space(car, (), ("grip_patch",)).centre for car in cars)
    assert there - here == pytest.approx([*away, 0.0, 0.0])


def test_noise_survives_a_car_file_and_drives_noisier_than_known_are_believed():
    noise = noises.Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))
    assert noises.noise_of_section(noises.noise_section(noise)) == noise
    assert noises.noise_of_section({}) is None
    with pytest.raises(ValueError, match="position"):
        noises.noise_of_section({"yaw": 1.0})
    older = {key: v for key, v in noises.noise_section(noise).items() if key != "wheel_slip"}
    assert noises.noise_of_section(older) == noise
    known = noises.Noise((1e-3, 2e-3, 0.06, 0.05), (0.4, 0.3, 2.0))
    heard = noises.noisier_of(known, np.array([2e-3, 2.1e-3, 0.01, 0.0]))
    assert (heard.instruments, heard.pushes) == ((2e-3, 2e-3, 0.06, 0.05), known.pushes)


def test_a_slipping_wheel_is_off_by_speed_times_acceleration(healthy):
    error, _ = healthy.errors(healthy.augmented.base, healthy.guess)
    shape = noises.slip_shape(healthy, error)
    wheel = (healthy.layout.channel[healthy.padded.row] == 3) & (healthy.padded.there > 0)
    slip = np.sqrt(np.diagonal(shape, axis1=1, axis2=2))
    assert (slip[~wheel] == 0.0).all()
    speed = healthy.pad(healthy.layout.values) - error
    for w in range(3):
        t, v = healthy.layout.row_t[healthy.padded.row[w, wheel[w]]], speed[w, wheel[w]]
        assert slip[w, wheel[w]] == pytest.approx(np.abs(v * np.gradient(v, t)))


def test_a_wheel_that_is_trusted_little_leaves_little(healthy):
    there = healthy.padded.there.sum()
    quiet, loud = noises.noise_floor(healthy, 1e-3), noises.noise_floor(healthy, 0.06)
    assert loud == pytest.approx(NOISE_KEPT)
    wheel = (healthy.layout.group == 2).sum()
    assert quiet < loud * (1.0 - 0.9 * wheel / there)


def test_prescribed_speed_tells_nothing_of_the_drive(healthy, drive):
    runs = drive("", 1, 4.0)
    assert "accel_limit" in informative_effects(healthy.augmented, runs)
    measured = [replace(run, speed_source="wheel") for run in runs]
    left = informative_effects(healthy.augmented, measured)
    assert not {"accel_limit", "rolling_drag", "drive_delay"} & set(left)
    assert "tyre_friction" in left


def test_a_push_along_the_car_shows_in_speed_alone_and_in_no_window_that_left_the_map(
    healthy, fitted
):
    """Such a window is lost whatever pushes it, and takes no other window along."""
    seen = responses(healthy, fitted.parameters, fitted.x)
    assert seen.shape[0] == len(INPUTS)
    channel = healthy.layout.channel[healthy.padded.row]
    t = healthy.layout.row_t[healthy.padded.row]
    wheel = (channel == 3) & (healthy.padded.there > 0)
    assert np.abs(seen[0][:, :, -1][wheel & (t < 0.85)]).max() < 1e-9
    late = seen[0][:, :, 0][wheel & (t > 0.15) & (t < 0.25)]
    assert ((late > 0.0) & (late < 0.11)).all()
    x = fitted.x.copy()
    x[2, 3] = np.nan
    without, others = responses(healthy, fitted.parameters, x), np.arange(len(x)) != 2
    assert (without[:, 2] == 0.0).all()
    assert np.allclose(without[:, others], seen[:, others], rtol=1e-9, atol=1e-9)


def _left(predictor, noise):
    """What is left of the base per degree of freedom, its starts at their best."""
    space, guess = make_space(predictor.augmented, ()), predictor.guess
    likelihood = make_likelihood(predictor, predictor.augmented.base, guess, noise)
    return robust_mean(settled(likelihood, space, space.centre).at.ratio)


def test_noise_is_learnt_within_a_factor_and_when_calibrated_leaves_one(healthy, fitted):
    noise = noises.learn_noise(healthy, fitted.parameters, fitted.x, fitted.linear)
    assert 4e-4 < noise.instruments[0] < 1.2e-3
    assert 0.2 < noise.pushes[0] < 0.8
    assert 1.2 < noise.pushes[2] < 5.0
    assert 0.6 < _left(healthy, noise) < 1.4
    noise = noises.Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))
    left = _left(healthy, noise)
    assert _left(healthy, noises.calibrated(noise, left)) == pytest.approx(1.0, abs=0.03)
    assert _left(healthy, noises.calibrated(noise, left, 0.8)) == pytest.approx(0.8, abs=0.03)
