"""Windows, whitening and descent: numbers against their definitions."""

from dataclasses import replace

import numpy as np
import pytest
from steerd.sim_gap.verdict.candidates import blocks_of, folds_of, held_out
from steerd.sysid.inference.levenberg_marquardt import minimise, settle_starts

from steerd.sysid.data.windows import speed_range
from steerd.sysid.estimation.bounded_step import step_within
from steerd.sysid.inference.constants import NOISE_KEPT
from steerd.sysid.inference.disturbance_response import INPUTS, responses
from steerd.sysid.inference.engine import make_engine, take_windows
from steerd.sysid.inference.noise import (
    Noise,
    calibrated,
    learn_noise,
    louder,
    noise_floor,
    noise_of_section,
    noise_section,
    slip_shape,
    whitened,
)
from steerd.sysid.inference.readings import SPACING, make_readings
from steerd.sysid.inference.residuals import robust_mean, settled
from steerd.sysid.inference.space import BOX, informative_effects, make_space, nuisance_names
from steerd.sysid.inference.superset import make_superset

SIGMA = np.array([0.005, 0.01, 0.05, 0.05])


@pytest.fixture(scope="module")
def healthy(drive, base):
    runs = drive("", runs=2, seconds=6.0, seed=7)
    superset = make_superset(base, runs)
    return make_engine(superset, make_readings(runs, 0.0, speed_range(runs)), SIGMA)


@pytest.fixture(scope="module")
def fitted(healthy, drive):
    space = make_space(healthy.superset, nuisance_names(healthy.superset, drive("", 1, 4.0)))
    return minimise(healthy, space, space.centre, healthy.readings.layout.guess.copy())


def test_readings_are_thinned_to_one_each_fifty_milliseconds(healthy):
    readings = healthy.readings
    for w in range(readings.count):
        rows = readings.rows(w)
        t = readings.t[rows][readings.channel[rows] == 0]
        assert np.all(np.abs(np.diff(t) - SPACING) < 0.011)
        assert len(t) >= 20


def test_a_slope_is_the_difference_quotient(healthy, fitted):
    space, z, x = fitted.space, fitted.z, fitted.x
    at = healthy.linear(space, z, x)
    i = space.chart.labels.index("steer_gain")
    moved = z.copy()
    moved[i] += 1e-5
    quotient = (at.error - healthy.linear(space, moved, x).error) / 1e-5
    scale = np.abs(at.by_z[:, :, i]).max()
    assert np.abs(quotient - at.by_z[:, :, i]).max() < 1e-3 * scale


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("steer_delay", (0.0134,)),
        ("steer_backlash", (0.02,)),
        ("steer_rate_limit", (1.5,)),
        ("tyre_relaxation", (0.03,)),
        ("mocap_latency", (0.021,)),
        ("marker_offset", (0.02, 0.01)),
        ("grip_drift", (0.3,)),
    ],
)
def test_readings_without_derivatives_are_the_same_numbers(healthy, effect, values):
    space = make_space(healthy.superset, (), [effect])
    x = healthy.readings.layout.guess.copy()
    x[:, 6] = 0.002
    z = np.array(values)
    alone, finite = healthy.missed(space, z, x)
    assert finite
    assert np.abs(alone - healthy.linear(space, z, x).error).max() < 1e-12


def test_derivatives_of_a_near_point_give_the_same_losses(healthy, fitted):
    space, z, x = fitted.space, fitted.z, fitted.x
    linear = healthy.linear(space, z, x)
    whole = healthy.eliminate(linear, x)
    parts = healthy.reduce_by(healthy.tangent(linear), linear.error, x)
    assert np.allclose(whole.square, parts.square)
    assert np.allclose(whole.g, parts.g)


def test_effects_at_their_nulls_change_no_bit(healthy, fitted):
    names = [e.name for e in healthy.superset.effects if e.name != "grip_patch"]
    wide = make_space(healthy.superset, (), names[:12])
    plain = make_space(healthy.superset, ())
    a = healthy.linear(plain, plain.centre, fitted.x).error
    b = healthy.linear(wide, wide.centre, fitted.x).error
    assert np.array_equal(a, b)


def test_the_base_stays_in_its_box(fitted):
    space = fitted.space
    own = slice(0, space.nuisance)
    assert np.all(np.abs(fitted.prior[own]) <= BOX + 1e-9)


def test_noise_is_learnt_within_a_factor(healthy, fitted):
    noise = learn_noise(healthy, fitted)
    assert 4e-4 < noise.instruments[0] < 1.2e-3
    assert 0.2 < noise.pushes[0] < 0.8
    assert 1.2 < noise.pushes[2] < 5.0
    engine = whitened(healthy, fitted, noise)
    best = minimise(engine, fitted.space, fitted.z, fitted.x)
    assert 0.6 < robust_mean(best.at.square / best.at.dof) < 1.4


def test_noise_survives_a_car_file():
    noise = Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))
    assert noise_of_section(noise_section(noise)) == noise
    assert noise_of_section({}) is None
    with pytest.raises(ValueError, match="position"):
        noise_of_section({"yaw": 1.0})
    older = {key: v for key, v in noise_section(noise).items() if key != "wheel_slip"}
    assert noise_of_section(older) == noise


def test_a_slipping_wheel_is_off_by_speed_times_acceleration(healthy):
    error, _ = healthy.missed(*_at_base(healthy))
    shape = slip_shape(healthy, error)
    wheel = (healthy.readings.channel[healthy.padded.row] == 3) & (healthy.padded.there > 0)
    slip = np.sqrt(np.diagonal(shape, axis1=1, axis2=2))
    assert (slip[~wheel] == 0.0).all()
    speed = healthy.pad(healthy.readings.layout.values) - error
    for w in range(3):
        t = healthy.readings.t[healthy.padded.row[w, wheel[w]]]
        v = speed[w, wheel[w]]
        assert slip[w, wheel[w]] == pytest.approx(np.abs(v * np.gradient(v, t)))


def test_calibrated_noise_leaves_one(healthy):
    space, z, x = _at_base(healthy)
    noise = Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))
    fitted = settled(healthy, space, z, x)
    first = settled(whitened(healthy, fitted, noise), space, z, x)
    left = robust_mean(first.at.square / first.at.dof)
    again = settled(whitened(healthy, fitted, calibrated(noise, left)), space, z, x)
    assert robust_mean(again.at.square / again.at.dof) == pytest.approx(1.0, abs=0.03)
    less = settled(whitened(healthy, fitted, calibrated(noise, left, 0.8)), space, z, x)
    assert robust_mean(less.at.square / less.at.dof) == pytest.approx(0.8, abs=0.03)


def _at_base(engine):
    space = make_space(engine.superset, ())
    return space, space.centre, engine.readings.layout.guess


def test_drives_noisier_than_known_are_believed():
    known = Noise((1e-3, 2e-3, 0.06, 0.05), (0.4, 0.3, 2.0))
    heard = louder(known, np.array([2e-3, 2.1e-3, 0.01, 0.0]))
    assert heard.instruments == (2e-3, 2e-3, 0.06, 0.05)
    assert heard.pushes == known.pushes


def test_a_wheel_that_is_trusted_little_leaves_little(healthy):
    there = healthy.padded.there.sum()
    quiet, loud = noise_floor(healthy, 1e-3), noise_floor(healthy, 0.06)
    assert loud == pytest.approx(NOISE_KEPT)
    wheel = (healthy.readings.layout.group == 2).sum()
    assert quiet < loud * (1.0 - 0.9 * wheel / there)


def test_prescribed_speed_tells_nothing_of_the_drive(healthy, drive):
    runs = drive("", 1, 4.0)
    assert "accel_limit" in informative_effects(healthy.superset, runs)
    measured = [replace(run, speed_source="wheel") for run in runs]
    left = informative_effects(healthy.superset, measured)
    assert not {"accel_limit", "rolling_drag", "drive_delay"} & set(left)
    assert "tyre_friction" in left


def test_a_push_along_the_car_shows_in_speed_and_nowhere_before(healthy, fitted):
    seen = responses(healthy, fitted.parameters, fitted.x)
    assert seen.by_input.shape[0] == len(INPUTS)
    channel = healthy.readings.channel[healthy.padded.row]
    t = healthy.readings.t[healthy.padded.row]
    wheel = (channel == 3) & (healthy.padded.there > 0)
    last = seen.by_input[0][:, :, -1]
    assert np.abs(last[wheel & (t < 0.85)]).max() < 1e-9
    first = seen.by_input[0][:, :, 0]
    late = first[wheel & (t > 0.15) & (t < 0.25)]
    assert np.all(late > 0.0)
    assert np.all(late < 0.11)


def test_windows_taken_out_read_the_same(healthy, fitted):
    chosen = np.arange(healthy.readings.count) % 2 == 0
    part = take_windows(healthy, chosen)
    space = make_space(healthy.superset, ())
    whole = healthy.linear(space, space.centre, fitted.x).error[chosen]
    taken = part.linear(space, space.centre, fitted.x[chosen]).error
    assert np.allclose(whole[:, : taken.shape[1]], taken, atol=1e-12)


def test_starts_at_their_best_lower_the_error(healthy):
    space = make_space(healthy.superset, ())
    guess = healthy.readings.layout.guess
    before = healthy.reduce(space, space.centre, guess).square.sum()
    after = settled(healthy, space, space.centre).at.square.sum()
    assert after <= before


def test_a_lost_window_is_taken_up_anew_from_the_poses(healthy, fitted):
    spun = fitted.x.copy()
    spun[3] += [2.0, -2.0, 3.0, -2.0, 40.0, 2.0, 0.0]
    again = minimise(healthy, fitted.space, fitted.z.copy(), spun)
    assert again.cost == pytest.approx(fitted.cost, rel=1e-3)
    assert again.at.square[3] == pytest.approx(fitted.at.square[3], rel=0.1)


def test_losses_take_no_promise_of_a_start_that_it_cannot_keep(healthy, fitted):
    """Else a search compares its steps with a cost that nothing reaches, and stops anywhere."""
    space, z, rng = fitted.space, fitted.z, np.random.default_rng(5)
    x = fitted.x + rng.standard_normal(fitted.x.shape) * [0.05, 0.05, 0.1, 0.3, 1.0, 0.1, 0.1]
    x[::4] += [0.3, -0.3, 1.5, 2.0, 20.0, 1.2, 0.0]
    linear = healthy.linear(space, z, x)
    found = settle_starts(healthy, space, z, x, linear)
    error, _ = healthy.missed(space, z, found.x)
    actual = healthy.square_at(error, found.x)
    held = ~found.tangent.inverse.any(axis=(1, 2))
    assert held.any(), "some windows are too bent to be settled from so far"
    assert not held.all()
    assert np.all(actual[~held] - found.at.square[~held] < 0.1)
    assert np.allclose(actual[held], found.at.square[held], rtol=1e-9)
    assert not found.at.dx[held].any()
    assert not found.at.kx[held].any()
    assert np.all(actual <= healthy.square_at(linear.error, x) * (1.0 + 1e-9))


def test_leaving_windows_out_costs_something(healthy, fitted):
    losses = held_out(fitted, folds_of(healthy))
    assert losses.sum() >= fitted.at.loss.sum()
    assert len(np.unique(blocks_of(healthy))) >= 4


def test_a_step_stays_within_bounds():
    h = np.array([[2.0, 0.5], [0.5, 1.0]])
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 0.1])
    z = np.array([0.0, 0.1])
    dz = step_within(h, np.array([1.0, 5.0]), z, low, high)
    assert dz[1] == 0.0
    assert dz[0] == pytest.approx(0.5)


def test_a_window_that_left_the_map_answers_to_nothing(healthy, fitted):
    """It is lost whatever pushes it, and takes no other window along."""
    whole = responses(healthy, fitted.parameters, fitted.x).by_input
    x = fitted.x.copy()
    x[2, 3] = np.nan
    seen = responses(healthy, fitted.parameters, x).by_input
    others = np.arange(len(x)) != 2
    assert (seen[:, 2] == 0.0).all()
    assert np.allclose(seen[:, others], whole[:, others], rtol=1e-9, atol=1e-9)
