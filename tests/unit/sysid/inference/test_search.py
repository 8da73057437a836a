"""The search as a search: what it promises it keeps, and no start finds a better optimum."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sysid.data.dataset import Signal
from steerd.sysid.inference import constants as c
from steerd.sysid.inference import search
from steerd.sysid.inference.augmented_car import make_augmented_car
from steerd.sysid.inference.hypotheses import begin
from steerd.sysid.inference.library import Library
from steerd.sysid.inference.likelihood import loss_of, take_some
from steerd.sysid.inference.posterior import between_halves, posterior_of
from steerd.sysid.inference.space import make_space, weak_knowledge
from steerd.sysid.inference.starts import owes, settle_starts
from tests.unit.sysid.inference.conftest import FEW, likelihood_of

LATE = 0.03
MOST_SPREADS = 2.5  # prior standard deviations over which random starts are drawn, each way


@pytest.fixture(scope="module")
def late(drive, base):
    """Two drives with late steering; the cameras lose the first for a third of a second."""
    one, other = drive(f"steer_delay={LATE}", runs=2, seconds=6.0, seed=21)
    seen = np.abs(one.pose.t - 2.5) > 0.17
    one = replace(one, pose=Signal(one.pose.t[seen], one.pose.values[seen]))
    return likelihood_of(make_augmented_car(base, [one, other]), [one, other])


@pytest.fixture(scope="module")
def found(late):
    """The optimum with the effect, from the base at its prior."""
    library = Library(late, FEW, ())
    guess = late.predictor.guess
    return search.minimise(late, begin(library, ("steer_delay",), (0.0,), guess))


@pytest.fixture(scope="module")
def settled_base(likelihood, small):
    point = search.stand(likelihood, small, small.centre, likelihood.predictor.guess, 0.0)
    return search.fresh(likelihood, point)


def test_the_effect_is_found_with_its_size_at_the_cost_that_is_simulated_there(late, found):
    """No cost rests on derivatives of another point, or on a start's unfulfilled promise."""
    assert found.z[-1] == pytest.approx(LATE, abs=0.002)
    assert found.whole
    assert found.size < c.GAP_SIZE
    again = search.stand(late, found.space, found.z, found.x, found.size)
    assert again.cost == pytest.approx(found.cost, abs=0.1)
    reached = late.squares(late.rotate_error(again.linear.error), again.x, again.size)
    assert again.at.here == pytest.approx(reached)
    assert (reached - again.at.square < 0.06).all()


@pytest.mark.parametrize("seed", range(6))
def test_no_random_start_ends_lower(late, found, seed):
    """From anywhere in the prior, under the discrepancy that the start needs."""
    rng, space = np.random.default_rng([30, seed]), found.space
    z = space.centre + space.spread * rng.uniform(-MOST_SPREADS, MOST_SPREADS, len(space.centre))
    z[-1] = rng.uniform(0.0, 0.08)
    z = np.clip(z, space.low, space.high)
    start = search.stand(late, space, z, late.predictor.guess, 20.0)
    size = late.best_size(start.rotated, start.linear.error, start.x)
    other = search.minimise(late, search.with_size(late, start, size))
    assert other.cost == pytest.approx(found.cost, abs=0.5)


SMOOTH = ("c_sf", "c_sr", "inertia_z", "steer_lag", "tyre_relaxation.length", "scrub.yaw_damping")


@pytest.mark.parametrize("name", SMOOTH)
def test_the_cost_falls_as_its_derivatives_say(healthy, likelihood, name):
    """A part of the cost that no derivative sees ends searches off their optimum."""
    space = make_space(healthy.augmented, SMOOTH)
    i, z = space.chart.free.index(name), np.clip(space.centre, space.low + 1e-3, None)
    point = search.stand(likelihood, space, z, healthy.guess, 0.1)
    sd = np.linalg.inv(search.curvature(space, point.at))[i, i] ** 0.5
    costs = []
    for step in (0.1 * sd, -0.1 * sd):
        moved, started = z + step * np.eye(len(z))[i], point.x - point.at.kx[:, :, i] * step
        costs.append(search.stand(likelihood, space, moved, started, 0.1).cost)
    slope = point.at.weight @ point.at.g + space.prior_pull(z)
    assert (costs[1] - costs[0]) / 0.2 == pytest.approx(sd * slope[i], abs=0.1)


@pytest.mark.parametrize(("name", "step"), [("accel_max", 0.3), ("steer_rate", 0.05)])
def test_limits_are_differenced(healthy, likelihood, name, step):
    """A slope between two kinks leads nowhere."""
    space = make_space(healthy.augmented, (name,))
    z, guess = np.clip(space.centre, space.low + step, space.high - step), healthy.guess
    errors = [healthy.errors(space.chart.parameters(v), guess)[0] for v in (z, z + step)]
    found = search.derive(likelihood, space, z, guess).by_z[:, :, 0]
    assert found == pytest.approx((errors[0] - errors[1]) / step, abs=1e-6)


@pytest.mark.parametrize("name", ["steer_delay", "drive_delay"])
def test_readings_are_smooth_in_a_dead_time(healthy, name):
    """A servo at its slew limit turns for what is left of the step in which a command arrives."""
    space = make_space(healthy.augmented, (name,))
    grid, guess = healthy.finest.held.fine, healthy.guess
    at = grid * (np.floor(space.centre / grid) + np.linspace(1.1, 2.9, 10)[:, None])
    slopes = np.array([healthy.linear(space, z, guess).by_z[:, :, 0] for z in at])
    errors = np.array([healthy.errors(space.chart.parameters(z), guess)[0] for z in at])
    moved = (errors[0] - errors[-1]) / (at[-1, 0] - at[0, 0])
    assert np.abs(slopes.mean(axis=0) - moved).max() < 0.02 * np.abs(moved).max()
    assert np.ptp(slopes, axis=0).max() < 0.5 * np.abs(slopes).max()


STIFF = {"c_sf": 28.0, "c_sr": 22.0, "tyre_saturation.q": 1.5}


def test_a_start_that_cannot_keep_its_promise_is_held(likelihood, settled_base):
    """Else a search compares its steps with a cost that nothing reaches, and stops anywhere."""
    rng, augmented = np.random.default_rng(5), likelihood.predictor.augmented
    p, x = augmented.base.copy(), settled_base.x.copy()
    for name, value in STIFF.items():
        p[augmented.kernels.names.index(name)] = value
    augmented = replace(augmented, base=p)
    predictor = replace(likelihood.predictor, augmented=augmented).stepped_for(p)
    likelihood, space = replace(likelihood, predictor=predictor), make_space(augmented, FEW)
    x += rng.standard_normal(x.shape) * [0.05, 0.05, 0.1, 0.3, 1.0, 0.1, 0.1]
    x[::4] += [0.3, -0.3, 1.5, 2.0, 20.0, 1.2, 0.0]
    before = likelihood.rotate_error(predictor.errors(p, x)[0])
    found = search.stand(likelihood, space, space.centre, x, 0.0)
    row = likelihood.rotate_error(predictor.errors(p, found.x)[0])
    actual, held = likelihood.squares(row, found.x, 0.0), found.rotated.held
    assert held.any(), "some windows are too bent to be settled from so far"
    assert not held.all()
    promised = actual - found.at.square
    assert not owes(actual, promised, likelihood.dof)[~held].any()
    assert np.allclose(actual, found.at.here, rtol=1e-9)
    assert np.allclose(actual[held], found.at.square[held], rtol=1e-9)
    assert not found.at.dx[held].any()
    assert np.all(actual <= likelihood.squares(before, x, 0.0) * (1.0 + 1e-9))


def test_a_window_with_fewer_readings_settles_as_it_does_alone(late):
    p, there = late.predictor.augmented.base, late.predictor.padded.there
    few = there.sum(axis=1) < there.shape[1]

    def settled(part, x):
        return settle_starts(part, p, x, part.predictor.by_starts(p, x), 1.0)[0]

    x = settled(late, late.predictor.guess)
    x[few] += 0.05
    assert settled(late, x)[few] == pytest.approx(settled(take_some(late, few), x[few]), abs=1e-9)


@pytest.mark.parametrize("tyres", [{}, STIFF])
def test_starts_that_are_far_off_come_back(likelihood, small, settled_base, tyres):
    """Whichever way they are off: full steps of Newton lead away where tyres saturate."""
    costs, p, predictor = [], small.chart.parameters(small.centre).copy(), likelihood.predictor
    for name, value in tyres.items():
        p[predictor.augmented.kernels.names.index(name)] = value
    for seed in range(8):
        off = np.random.default_rng(seed).standard_normal(settled_base.x.shape)
        off *= [0.02, 0.02, 0.05, 0.1, 2.0, 0.3, 0.0] if seed else 0.0
        start = settled_base.x + off
        x, left = settle_starts(likelihood, p, start, predictor.by_starts(p, start), 0.02)
        assert not left.any()
        square = likelihood.squares(likelihood.rotate_error(predictor.errors(p, x)[0]), x, 0.02)
        costs.append(loss_of(square, likelihood.dof))
    assert (costs - costs[0]).max() < 0.1


def test_derivatives_are_those_where_the_starts_have_gone(likelihood, settled_base):
    """Only windows whose start moves are simulated again."""
    x = settled_base.x + np.where(np.arange(len(settled_base.x)) % 5, 0.0, 0.3)[:, None]
    point = search.fresh(likelihood, replace(settled_base, x=x))
    assert 0.0 < (point.x != x).any(axis=1).mean() < 0.5
    whole = search.derive(likelihood, point.space, point.z, point.x)
    assert np.allclose(point.linear.by_z, whole.by_z, rtol=1e-9, atol=1e-12)
    assert np.allclose(point.linear.by_x, whole.by_x, rtol=1e-9, atol=1e-12)


def test_a_search_cut_short_is_not_whole_and_a_start_that_diverges_is_said(late, likelihood, small):
    start = begin(Library(late, FEW, ()), ("steer_delay",), (0.0,), late.predictor.guess)
    assert not search.minimise(late, start, steps=2).whole
    x = likelihood.predictor.guess.copy()
    x[:, 3] = np.nan
    with pytest.raises(FloatingPointError, match="diverges"):
        search.stand(likelihood, small, small.centre, x, 1.0)


def _at_best(runs, base):
    augmented = make_augmented_car(base, runs)
    augmented = replace(augmented, knowledge=weak_knowledge(augmented, FEW))
    likelihood = likelihood_of(augmented, runs)
    point = begin(Library(likelihood, FEW, ()), (), (), likelihood.predictor.guess)
    return likelihood, search.minimise(likelihood, point)


def test_half_samples_of_a_right_model_vary_as_its_curvature_says(drive, base):
    found = []
    for seed in range(4):
        likelihood, point = _at_best(drive("", runs=2, seconds=8.0, seed=[31, seed]), base)
        blocks = np.arange(len(point.x)) // 2
        variance = np.diag(posterior_of(point, 1.0).covariance)
        found.append(between_halves(likelihood, point, blocks) / variance)
    assert 0.4 < np.mean(found) < 2.0


def test_half_samples_that_differ_have_their_distance(drive, base):
    """One drive has a steering bias to the left, the other as much to the right."""
    runs = [*drive("steer_bias=0.01", runs=1, seed=5), *drive("steer_bias=-0.01", runs=1, seed=6)]
    likelihood, point = _at_best(runs, base)
    both = between_halves(likelihood, point, likelihood.predictor.layout.run + 1)
    assert np.sqrt(both[point.space.chart.free.index("steer_bias")]) == pytest.approx(0.01, rel=0.2)
    assert not between_halves(likelihood, point, np.zeros(len(point.x), int)).any()
