"""The base's coordinates followed window by window; only what data replace is forgotten.

An information filter about a fixed anchor. Before a window's information is added, what is known in
just the directions that the window informs is faded (Cao and Schwartz, 2000): on a straight or at a
standstill no direction is informed, and nothing fades.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEMORY = 240.0
"""Windows after which information has faded to 1/e, where others bring the same: two minutes."""
INFORMED = 0.05
"""A direction counts as informed by a window from this share of its most informed one."""
DISCREPANCY = 16.0
"""Variances are this much larger than a likelihood says: what a model misses is alike from lap to
lap, and does not average out as noise does."""


@dataclass(frozen=True, eq=False)
class Track:
    """What is known of the base's coordinates, as deviations from the anchor.

    Attributes:
        information: (n, n), prior included.
        pull: (n,) information times the mean.
        prior: (n, n) information before any drive.
    """

    information: Array
    pull: Array
    prior: Array

    @property
    def mean(self) -> Array:
        """(n,) the best values."""
        return np.asarray(np.linalg.solve(self.information, self.pull))

    @property
    def covariance(self) -> Array:
        """(n, n) of the coordinates, discrepancy included, never wider than the prior."""
        data = (self.information - self.prior) / DISCREPANCY + self.prior
        return np.asarray(np.linalg.inv(0.5 * (data + data.T)))


def informed_directions(h: Array, prior: Array) -> Array:
    """(n, k) directions in which a window holds information, none for a window without information.

    Measured against the prior, so that units do not matter.
    """
    lower = np.linalg.cholesky(prior)
    scaled = np.linalg.solve(lower, np.linalg.solve(lower, h).T)
    values, axes = np.linalg.eigh(0.5 * (scaled + scaled.T))
    chosen = axes[:, values > max(INFORMED * float(values[-1]), 1e-6)]
    return np.asarray(np.linalg.solve(lower.T, chosen))


def follow(track: Track, g: Array, h: Array, memory: float = MEMORY) -> Track:
    """The track with one more window.

    Args:
        track: before it.
        g: (n,) the window's pull about the anchor, weighed.
        h: (n, n) its information, weighed.
        memory: windows after which information has faded to 1/e.
    """
    mean, old = track.mean, track.information - track.prior
    directions = informed_directions(h, track.prior)
    faded = old
    if directions.shape[1]:
        wide = old @ directions
        inner = directions.T @ wide + 1e-9 * np.eye(directions.shape[1])
        share = 1.0 - float(np.exp(-1.0 / memory))
        faded = old - share * wide @ np.linalg.solve(inner, wide.T)
    kept = track.prior + 0.5 * (faded + faded.T)
    return Track(kept + h, kept @ mean + g, track.prior)
