"""Evidence and covariance against exact ones; the design effect and the share beyond a size."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm

from steerd.sysid.inference.likelihood import SIZES
from steerd.sysid.inference.posterior import design_effect, log_mean, log_share_beyond, posterior_of

ROWS = 30


def _linear(seed: int, n: int, flat: int = 0, temper: float = 1.0):
    """A linear Gaussian model at its tempered optimum, its data and its derivatives.

    The last `flat` directions do nothing; priors' widths differ by four decades.
    """
    rng = np.random.default_rng(seed)
    by_z = rng.standard_normal((ROWS, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n)
    by_z[:, n - flat :] = 0.0
    root = rng.standard_normal((n, n)) + 2.0 * np.eye(n)
    scale = 10.0 ** rng.uniform(-2.0, 2.0, n)
    covariance = scale[:, None] * (root @ root.T) * scale
    precision, centre = np.linalg.inv(covariance), rng.standard_normal(n)
    data = by_z @ (centre + np.linalg.cholesky(covariance) @ rng.standard_normal(n))
    data += rng.standard_normal(ROWS)
    fisher = by_z.T @ by_z
    pull = by_z.T @ data / temper + precision @ centre
    z = np.linalg.solve(fisher / temper + precision, pull)
    error = data - by_z @ z
    point = SimpleNamespace(
        space=SimpleNamespace(covariance=covariance, precision=temper * precision, centre=centre),
        at=SimpleNamespace(weight=np.ones(1), h=fisher[None], loss=0.5 * error[None] @ error),
        z=z,
    )  # fmt: skip
    return point, data, by_z


@pytest.mark.parametrize("temper", [1.0, 9.0])
@pytest.mark.parametrize("seed", range(8))
def test_evidence_of_a_linear_model_is_the_exact_marginal_likelihood(seed: int, temper: float):
    """A tempered Gaussian likelihood is one of a variance as many times as large."""
    point, data, by_z = _linear(seed, 4, seed % 2, temper)
    space = point.space
    marginal = temper * np.eye(ROWS) + by_z @ space.covariance @ by_z.T
    exact = multivariate_normal(by_z @ space.centre, marginal).logpdf(data)
    exact += 0.5 * ROWS * np.log(2.0 * np.pi * temper)
    found, precision = posterior_of(point, temper), np.linalg.inv(space.covariance)
    assert found.evidence == pytest.approx(exact, rel=1e-6)
    expected = np.linalg.inv(precision + by_z.T @ by_z / temper)
    assert found.covariance == pytest.approx(expected, rel=1e-4)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(0, 2), st.floats(1, 30))
def test_a_covariance_is_positive_definite(seed: int, n: int, flat: int, temper: float) -> None:
    point, _, _ = _linear(seed, n, min(flat, n))
    covariance = posterior_of(point, temper).covariance
    sd, spread = (np.sqrt(np.diag(each)) for each in (covariance, point.space.covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(sd, sd)).min() > -1e-9
    assert (sd > 0.0).all()
    assert (sd <= spread * (1.0 + 1e-6)).all(), "drives cannot make a prior wider"


def test_what_nothing_shows_keeps_its_priors_width() -> None:
    point, _, _ = _linear(4, 3)
    for flat in (0.0, -1e-12):  # rounding, seen by a curvature that is none
        point.at.h = flat * np.eye(3)[None]
        assert posterior_of(point, 5.0).covariance == pytest.approx(point.space.covariance)


def test_the_design_effect_lies_between_two_and_all_windows(likelihood) -> None:
    count = len(likelihood.pushed)
    found = [design_effect(likelihood, float(size)) for size in SIZES]
    assert found[0] == pytest.approx(2.0 + (count - 1) * 0.5 * likelihood.pushed.mean())
    assert (np.diff(found) > 0.0).all()
    assert 2.0 <= found[0] < found[-1] <= count + 1.0
    assert design_effect(likelihood, 0.0, controlled=True) == 2.0
    controlled = [design_effect(likelihood, float(size), True) for size in SIZES]
    assert (np.array(controlled) <= found).all()


@pytest.mark.parametrize(
    ("value", "sd", "null", "least"),
    [(0.03, 0.01, 0.0, 0.002), (-0.4, 0.5, 0.1, 0.6), (0.02, 1e-5, 0.0, 0.002)],
)
def test_the_share_beyond_a_size_is_that_of_a_normal_value(value, sd, null, least) -> None:
    share = norm(value, sd).sf(null + least) + norm(value, sd).cdf(null - least)
    assert log_share_beyond(value, sd, null, least) == pytest.approx(np.log(share), abs=1e-9)
    assert log_share_beyond(value, 0.0, null, 0.0) == pytest.approx(0.0, abs=1e-9)
    assert log_share_beyond(1e-4, 1e-5, 0.0, 0.002) < -20.0, "surely small"


@pytest.mark.parametrize("seed", range(6))
def test_the_mean_of_a_normal_likelihood_is_the_exact_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root, wide = rng.standard_normal((2, 3, 3))
    data, spread = root @ root.T + 0.1 * np.eye(3), wide @ wide.T + 0.1 * np.eye(3)
    mean, best = rng.standard_normal((2, 3))
    exact = multivariate_normal(mean, spread + np.linalg.inv(data)).logpdf(best)
    exact += 0.5 * (best @ data @ best + 3.0 * np.log(2.0 * np.pi) - np.linalg.slogdet(data)[1])
    assert log_mean(data, data @ best, mean, spread) == pytest.approx(exact)
