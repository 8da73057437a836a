"""Least squares, jackknife errors and delays that both calibrations use. Pure."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from steerd.sysid.data.data_checks import Array

Mask = NDArray[np.bool_]

MOVING = 0.2  # slower motion is mostly noise [m/s]
BLOCKS = 10  # contiguous blocks left out in turn (delete-a-group jackknife)
DELAY_LOW, DELAY_HIGH, DELAY_STEP = -0.05, 0.25, 0.01  # range and grid of the delay search [s]
LATERAL_ACCEL_MAX = 2.0  # above this the tyres' slip is no longer small [m/s^2]


def solve_least_squares(rows: Array, values: Array) -> tuple[Array, Array]:
    """Solve `rows @ x = values` in the least-squares sense.

    Args:
        rows: regressors, shape (n, k).
        values: shape (n,).

    Returns:
        The solution, shape (k,), and the residuals, shape (n,).
    """
    solution = np.linalg.lstsq(rows, values, rcond=None)[0]
    return np.asarray(solution, dtype=np.float64), values - rows @ solution


def jackknife_sd(
    good: Mask, estimate: Callable[[Mask], Array | Sequence[float]]
) -> tuple[float, ...]:
    """Standard errors of estimates from their values without each block of samples in turn.

    Args:
        good: samples that may be used, shape (n,).
        estimate: from some of them.
    """
    parts = []
    for block in np.array_split(np.flatnonzero(good), BLOCKS):
        mask = good.copy()
        mask[block] = False
        parts.append(estimate(mask))
    return tuple((np.sqrt(BLOCKS - 1) * np.std(np.array(parts), axis=0)).tolist())


def find_delay(cost: Callable[[float], float]) -> float:
    """The delay of least cost [s]: the best of a grid, refined."""
    grid = np.arange(DELAY_LOW, DELAY_HIGH, DELAY_STEP)
    at = float(grid[int(np.argmin([cost(float(tau)) for tau in grid]))])
    found = minimize_scalar(cost, bounds=(at - DELAY_STEP, at + DELAY_STEP), method="bounded")
    return float(found.x)


def find_slip_warnings(lateral: Array) -> list[str]:
    """Warnings about a drive with these lateral accelerations [m/s^2], shape (n,)."""
    if float(np.quantile(np.abs(lateral), 0.95)) <= LATERAL_ACCEL_MAX:
        return []
    limit = f"{LATERAL_ACCEL_MAX:g} m/s²"
    return [f"it corners with more than {limit}: tyre slip biases the result, drive slower"]
