"""Losses of windows against dense covariances and joint least squares."""

import numpy as np
import pytest

from steerd.sysid.inference import constants as c
from steerd.sysid.inference.disturbance_response import responses
from steerd.sysid.inference.likelihood import SIZES, loss_of, take_some
from steerd.sysid.inference.noise import MEMORY, instrument_variance, learn_noise, slip_shape
from steerd.sysid.inference.search import stand
from tests.unit.sysid.inference.conftest import NOISE


@pytest.fixture(scope="module")
def dense(healthy):
    """(W, D, D) covariances of healthy windows and of a discrepancy of size 1, 0 in padding."""
    parameters, x = healthy.augmented.base, healthy.guess
    seen = responses(healthy, parameters, x, (0, 1, 2))

    def coloured(sizes, memory):
        at = 0.1 * np.arange(seen.shape[3])
        kernel = np.exp(-np.abs(at[:, None] - at) / memory)
        return np.einsum("i,iwdp,pq,iweq->wde", np.square(sizes), seen, kernel, seen, optimize=True)

    own = NOISE.wheel_slip**2 * slip_shape(healthy, healthy.errors(parameters, x)[0])
    own[:, range(own.shape[1]), range(own.shape[1])] += instrument_variance(healthy, NOISE)
    return own + coloured(NOISE.pushes, MEMORY), coloured(c.DISCREPANCY, c.DISCREPANCY_MEMORY)


@pytest.fixture(scope="module")
def linear(likelihood, small):
    """Errors and derivatives a little off the base, at starts that are not settled."""
    z = small.centre + 0.5 * small.spread
    return likelihood.predictor.linear(small, z, likelihood.predictor.guess)


@pytest.fixture(scope="module")
def x(healthy):
    """Starts away from their first guesses: their prior counts."""
    away = np.random.default_rng(3).standard_normal(healthy.guess.shape)
    return healthy.guess + 0.3 * healthy.start_spread * away


def test_a_window_that_spins_beyond_all_bounds_tells_no_noise(healthy, linear):
    by_x = linear.by_x.copy()
    by_x[1] *= 1e6
    at = healthy, healthy.augmented.base, healthy.guess
    sizes, others = (learn_noise(*at, linear._replace(by_x=by)).sizes for by in (by_x, linear.by_x))
    assert sizes[:-1] == pytest.approx(others[:-1], rel=0.3)  # wheels slip too little


def test_one_rotation_diagonalises_both_covariances(likelihood, dense):
    own, unknown = dense
    turned = likelihood.rotation.transpose(0, 2, 1)
    there = likelihood.predictor.padded.there
    one = np.eye(there.shape[1])
    assert likelihood.rotation @ own @ turned == pytest.approx(one * there[:, :, None], abs=1e-7)
    spectrum = likelihood.rotation @ unknown @ turned
    assert spectrum == pytest.approx(one * likelihood.spectrum[:, :, None], abs=1e-6)
    shares = [likelihood.share(float(size)) for size in SIZES]
    assert shares[0] == 0.0 < shares[-1] < 1.0
    assert (np.diff(shares) > 0.0).all()
    assert ((likelihood.pushed > 0.0) & (likelihood.pushed < 1.0)).all()


@pytest.mark.parametrize("size", [0.0, 0.07, 1.0, 40.0])
def test_squares_and_determinants_are_those_of_the_dense_covariance(
    likelihood, dense, linear, x, size
):
    own, unknown = dense
    by = likelihood.weigh(likelihood.rotate(linear), size)
    square = likelihood.squares(likelihood.rotate_error(linear.error), x, size)
    about = likelihood.predictor  # the trajectories that the responses are about
    by_start = about.by_starts(about.augmented.base, about.guess)[1]
    for w in range(len(x)):
        whole = own[w] + size**2 * unknown[w]
        error, by_x, away = linear.error[w], by_start[w], likelihood.predictor.guess[w] - x[w]
        prior = np.diag(likelihood.start_precision[w])
        expected = error @ np.linalg.solve(whole, error) + away @ prior @ away
        assert square[w] == pytest.approx(expected, rel=1e-7)
        start = by_x.T @ np.linalg.solve(whole, by_x) + prior
        present = np.ix_(*2 * [likelihood.predictor.padded.there[w] > 0.0])
        logs = np.linalg.slogdet(whole[present])[1] + np.linalg.slogdet(start)[1]
        assert by.volume[w] == pytest.approx(0.5 * logs, rel=1e-7)


@pytest.mark.parametrize("size", [0.0, 0.5])
def test_the_eliminated_start_is_that_of_a_joint_least_squares(likelihood, dense, linear, x, size):
    own, unknown = dense
    at = likelihood.reduce(likelihood.weigh(likelihood.rotate(linear), size), linear.error, x)
    for w in (0, 3, len(x) - 1):
        root = np.linalg.inv(np.linalg.cholesky(own[w] + size**2 * unknown[w]))
        prior = np.diag(np.sqrt(likelihood.start_precision[w]))
        away = likelihood.predictor.guess[w] - x[w]
        rows = np.vstack([root @ linear.by_x[w], prior])
        error = np.concatenate([root @ linear.error[w], prior @ away])
        dx, *_ = np.linalg.lstsq(rows, error, rcond=None)
        assert at.dx[w] == pytest.approx(dx, rel=1e-5, abs=1e-9)
        assert at.square[w] == pytest.approx(np.sum((error - rows @ dx) ** 2), rel=1e-7)
        by_z = np.vstack([root @ linear.by_z[w], np.zeros((7, linear.by_z.shape[2]))])
        kept = by_z - rows @ np.linalg.lstsq(rows, by_z, rcond=None)[0]
        assert at.h[w] == pytest.approx(kept.T @ kept, rel=1e-5, abs=1e-6 * np.abs(at.h[w]).max())
        assert at.g[w] == pytest.approx(kept.T @ error, rel=1e-5, abs=1e-6 * np.abs(at.g[w]).max())


def test_a_weight_is_the_slope_of_the_loss_and_a_window_that_spins_hardly_pulls(likelihood, small):
    """Half of it per square, below and beyond the bound from which a window counts as spun."""
    guess = likelihood.predictor.guess
    at = stand(likelihood, small, small.centre, guess, 0.0).at
    spun = at._replace(square=at.square * np.where(np.arange(len(guess)) == 2, 1e6, 1.0))
    assert 0.0 < spun.weight[2] < 1e-5 < np.delete(spun.weight, 2).min()
    usual = spun.dof[2] * np.log1p(spun.square[2] / spun.dof[2])
    bounded = spun.dof[2] * np.log1p(c.SPUN)
    found = loss_of(spun.square, spun.dof)[2]
    assert found == pytest.approx(bounded + c.SPUN_SHARE * (usual - bounded))
    for ratio in (0.5, 3.0, 0.9 * c.SPUN, 1.1 * c.SPUN, 50.0 * c.SPUN):
        square = ratio * at.dof
        low, high = (loss_of(share * square, at.dof) for share in (0.9999, 1.0001))
        slope = (high - low) / (2e-4 * square)
        assert at._replace(square=square).weight == pytest.approx(2.0 * slope, rel=1e-5)


@pytest.mark.parametrize("size", [0.0, 1.0, 5.0, 15.0])
def test_the_size_is_that_from_which_errors_were_drawn(likelihood, linear, size):
    """Errors of a known covariance, the starts fitted to them."""
    rng = np.random.default_rng(11)
    there, guess = likelihood.predictor.padded.there, likelihood.predictor.guess
    own = rng.standard_normal(there.shape) * np.sqrt(1.0 + size**2 * likelihood.spectrum) * there
    pairs = zip(likelihood.rotation, own, strict=True)
    error = np.stack([np.linalg.lstsq(*pair, rcond=None)[0] for pair in pairs])
    rotated = likelihood.rotate(linear)
    found = likelihood.best_size(rotated, error, guess)
    each = [likelihood.reduce(likelihood.weigh(rotated, s), error, guess) for s in SIZES]
    costs = [float((loss_of(at.square, at.dof) + at.volume).sum()) for at in each]
    assert found == SIZES[int(np.argmin(costs))]
    assert 0.7 * size <= found <= max(1.45 * size, 0.3)
    assert likelihood.best_size(rotated, error, guess, 2.0 * size + 1.0) >= 2.0 * size + 1.0


def test_some_windows_have_the_errors_and_losses_that_they_have_among_all(likelihood, small):
    guess = likelihood.predictor.guess
    chosen = np.arange(len(guess)) % 3 == 1
    part = take_some(likelihood, chosen)
    whole = stand(likelihood, small, small.centre, guess, 0.3)
    taken = stand(part, small, small.centre, guess[chosen], 0.3)
    width = taken.linear.error.shape[1]
    assert np.allclose(taken.linear.error, whole.linear.error[chosen, :width], atol=1e-12)
    assert taken.at.loss == pytest.approx(whole.at.loss[chosen], rel=1e-6)
