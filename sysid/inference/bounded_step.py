"""The step of a quadratic model within bounds: the one that every search for parameters takes."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

Array = NDArray[np.float64]

_EXCHANGES = 200
"""Of coordinates at and off their bounds, at most."""
_HAIR = 1e-12
"""Bounds must lie apart; where they do not, by so much."""


def step_within(h: Array, slope: Array, z: Array, low: Array, high: Array) -> Array:
    """The best step of the quadratic model within bounds.

    Newton's where that stays inside, else bounded least squares on the Cholesky factor (Stark and
    Parker, 1995). Clipping the step of coordinates that move together could go uphill.
    """
    dz = np.asarray(np.linalg.solve(h, slope), dtype=np.float64)
    if ((z + dz >= low) & (z + dz <= high)).all():
        return dz
    scale = 1.0 / np.sqrt(np.diag(h))
    try:
        lower = np.linalg.cholesky(0.5 * (h + h.T) * np.outer(scale, scale))
    except np.linalg.LinAlgError:  # two coordinates do the same to the last digit
        return _shortened(h, slope, z, low, high)
    room = np.where(high - low <= 0.0, _HAIR, np.maximum(high - z, 0.0))
    found = lsq_linear(
        lower.T, np.linalg.solve(lower, slope * scale),
        (np.minimum(low - z, 0.0) / scale, room / scale), method="bvls", max_iter=_EXCHANGES,
    )  # fmt: skip
    inside: Array = np.clip(z + found.x * scale, low, high) - z
    if float(slope @ inside - 0.5 * inside @ h @ inside) >= 0.0:
        return inside
    return _shortened(h, slope, z, low, high)


def _shortened(h: Array, slope: Array, z: Array, low: Array, high: Array) -> Array:
    """A step along the scaled gradient of what is not at a bound, cut where one is met."""
    dz = np.asarray(slope / np.diag(h), dtype=np.float64)
    dz[((z <= low) & (dz < 0.0)) | ((z >= high) & (dz > 0.0))] = 0.0
    moving = dz != 0.0
    if not moving.any():
        return dz
    room = np.where(dz > 0.0, high - z, z - low)
    share = float(np.min(room[moving] / np.abs(dz[moving]), initial=1.0))
    along = float(slope @ dz) / float(dz @ h @ dz)
    return np.asarray(min(share, along) * dz)
