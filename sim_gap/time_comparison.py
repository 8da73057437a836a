"""Two drives on one axis of time: their quantities, the difference, and how far they lie apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 0.01
"""Of the common axis [s]."""
REFINED = 0.5
"""Within this of the strongest correlation the best likeness is taken for the shift [s]."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A quantity of two drives on one axis of time; NaN where a drive has none of it."""

    title: str
    unit: str
    first: Array  # (n,) values of the first drive; second: of the second
    second: Array

    @property
    def difference(self) -> Array:
        """Second minus first."""
        return self.second - self.first


@dataclass(frozen=True, eq=False)
class Overlay:
    """Two drives over the time that they share."""

    t: Array  # since the first one's start (n,) [s]
    shift: float  # by which the second one comes later [s]
    found: bool  # whether that was found, not given
    pairs: tuple[Pair, ...]  # the quantities that both have


def find_shift(first: Sequence[Array], second: Sequence[Array]) -> float:
    """By how much a second drive must come later to resemble the first [s].

    The strongest cross-correlation of all quantities together finds the place (it favours long
    overlaps, so that of equal laps the nearest is taken); its coefficient over the overlap, which
    favours none, the shift.

    Args:
        first: quantities of the first drive, `STEP` apart, each (n,).
        second: the same quantities of the second, each (m,).
    """
    size = len(first[0]) + len(second[0])
    total, power = np.zeros(size), np.zeros(size)
    for one, other in zip(first, second, strict=True):
        mean, scale = np.nanmean(one), max(float(np.nanstd(one)), 1e-9)
        a, b = (np.nan_to_num((values - mean) / scale) for values in (one, other))
        here, there = (np.isfinite(values).astype(float) for values in (one, other))
        total += _correlate(a, b, size)
        power += np.sqrt(
            np.maximum(_correlate(a**2, there, size) * _correlate(here, b**2, size), 0.0)
        )
    lags = np.fft.fftfreq(size, 1.0 / size)
    near = np.abs(lags - lags[np.argmax(total)]) <= REFINED / STEP
    likeness = np.where(near, total / np.maximum(power, 1e-9), -np.inf)
    return float(lags[np.argmax(likeness)]) * STEP


def _correlate(a: Array, b: Array, size: int) -> Array:
    """Sum of `a[i + lag] b[i]` by lag, negative lags at the end."""
    spectrum = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
    return np.asarray(np.fft.irfft(spectrum, size))
