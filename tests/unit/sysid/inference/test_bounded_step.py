"""The step within bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from steerd.sysid.inference.bounded_step import step_within


def _quadratic(seed: int, n: int) -> tuple[np.ndarray, ...]:
    """A convex quadratic with strongly correlated coordinates, a point and bounds about it."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n)) @ np.diag(10.0 ** rng.uniform(-2.0, 2.0, n))
    h = root @ root.T + 1e-6 * np.eye(n)
    slope = root @ rng.standard_normal(n) * 10.0 ** rng.uniform(-1.0, 2.0)
    z = rng.standard_normal(n)
    low, high = z - rng.choice([0.0, 0.01, 1.0], n), z + rng.choice([0.0, 0.01, 1.0], n)
    return h, slope, z, low, high


@settings(deadline=None, max_examples=200)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 8))
def test_no_step_promises_less_than_nothing_or_leaves_the_bounds(seed: int, n: int) -> None:
    h, slope, z, low, high = _quadratic(seed, n)
    dz = step_within(h, slope, z, low, high)
    assert np.isfinite(dz).all()
    assert (z + dz >= low - 1e-12).all()
    assert (z + dz <= high + 1e-12).all()
    promised = slope @ dz - 0.5 * dz @ h @ dz
    assert promised >= -1e-9 * (1.0 + abs(slope @ dz))


def test_without_bounds_it_is_newtons_step() -> None:
    h, slope, z, _, _ = _quadratic(3, 5)
    wide = np.full(5, 1e9)
    assert step_within(h, slope, z, -wide, wide) == pytest.approx(np.linalg.solve(h, slope))


@pytest.mark.parametrize("seed", range(12))
def test_it_is_the_best_step_within_the_bounds(seed: int) -> None:
    """Against another of SciPy's bounded minimisers."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4)) + 2.0 * np.eye(4)
    h, slope = root @ root.T, 3.0 * rng.standard_normal(4)
    low, high = np.full(4, -0.3), np.full(4, 0.3)
    best = minimize(
        lambda d: 0.5 * d @ h @ d - slope @ d, np.zeros(4), jac=lambda d: h @ d - slope,
        bounds=list(zip(low, high, strict=True)),
    )  # fmt: skip
    dz = step_within(h, slope, np.zeros(4), low, high)
    assert slope @ dz - 0.5 * dz @ h @ dz == pytest.approx(-best.fun, rel=1e-5)


def test_two_coordinates_that_do_the_same_still_give_a_step() -> None:
    """A curvature that is singular to the last digit, with a bound in Newton's way."""
    h = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 - 1e-15, 0.0], [0.0, 0.0, 1.0]])
    slope, edge = np.array([1.0, 1.0, 1.0]), np.full(3, 0.1)
    dz = step_within(h, slope, np.zeros(3), -edge, edge)
    assert np.isfinite(dz).all()
    assert (np.abs(dz) <= 0.1).all()
    assert slope @ dz - 0.5 * dz @ h @ dz > 0.0


def test_a_step_stays_within_bounds() -> None:
    h = np.array([[2.0, 0.5], [0.5, 1.0]])
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 0.1])
    z = np.array([0.0, 0.1])
    dz = step_within(h, np.array([1.0, 5.0]), z, low, high)
    assert dz[1] == 0.0
    assert dz[0] == pytest.approx(0.5)
