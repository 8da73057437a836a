"""The base's coordinates followed window by window; only what data replace is forgotten.

An information filter about a fixed reference. Before a window's information is added, what is
known in just the directions that the window informs is faded (Cao and Schwartz, 2000): on a
straight or at a standstill no direction is informed, and nothing fades.

What an earlier drive of the same car taught is remembered: each number is a normal distribution,
inflated by the days since. It counts beside the first windows of a drive, not before them: a fit
that begins at a wrong car may stay there, and what these windows contradict is given up.
"""

# Why: docs/decisions/diagnosis.md#d87

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sim_gap.online.linearisation import Reference
from steerd.sysid.inference.augmented_car import AugmentedCar
from steerd.sysid.inference.space import Space, make_space

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
    """What is known of the base's coordinates, as deviations from the reference.

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
        g: (n,) the window's pull about the reference, weighed.
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


PER_DAY = 0.01
"""Each day adds this share of the car file's variance: a tenth of its standard deviation on the
first day, and after 25 days what was learnt says no more than the file."""
FORGOTTEN = 0.25
"""Share of the car file's variance from which on a number is not remembered."""
MEASURED = ("lf", "lr")
"""Never remembered: a ruler knows them better than any lane, and they stay as they are."""
CONTRADICTED = 3.0
"""Standard deviations, joined, between memory and first windows from which on it is given up."""


class Memory(NamedTuple):
    """What was kept of an earlier drive.

    Attributes:
        values: (value, standard deviation) by name, as learnt; SI units.
        days: how long ago that was.
    """

    values: Mapping[str, tuple[float, float]]
    days: float


class Remembered(NamedTuple):
    """One number as it is believed today: a value and its standard deviation, SI units."""

    name: str
    value: float
    sd: float


def remember(augmented: AugmentedCar, memory: Memory) -> tuple[Remembered, ...]:
    """What of a memory still says more than the car file.

    Args:
        augmented: the car file's base.
        memory: of an earlier drive of that car.
    """
    names = [n for n in memory.values if n in augmented.kernels.names and n not in MEASURED]
    space = make_space(augmented, names)
    found = []
    for i, name in enumerate(space.chart.free[: space.nuisance]):
        value, sd = memory.values[name]
        before = _slope(space, i) * float(space.spread[i])
        today = float(np.hypot(sd, before * np.sqrt(PER_DAY * max(memory.days, 0.0))))
        if today**2 < FORGOTTEN * before**2:
            found.append(Remembered(name, value, today))
    return tuple(found)


def _slope(space: Space, place: int) -> float:
    """How fast a parameter follows its own coordinate."""
    row = space.chart.names.index(space.chart.free[place])
    return abs(float(space.chart.slopes(space.centre)[row, place]))


def with_memory(reference: Reference, track: Track, remembered: Sequence[Remembered]) -> Track:
    """What is known of the base with what an earlier drive taught.

    Args:
        reference: the car as the first windows show it.
        track: what they say about it.
        remembered: of the earlier drive.

    Returns:
        The track as it was where one of the numbers contradicts these windows: it was another car.
    """
    space, by_name = reference.space, {each.name: each for each in remembered}
    names, at = reference.augmented.kernels.names, reference.augmented.base.copy()
    own = [i for i, name in enumerate(space.chart.free[: space.nuisance]) if name in by_name]
    for i in own:
        at[names.index(space.chart.free[i])] = by_name[space.chart.free[i]].value
    away = (space.chart.coordinates(at) - space.centre)[own]
    sd = np.array([by_name[space.chart.free[i]].sd / _slope(space, i) for i in own])
    seen = np.diag(track.covariance)[own]
    if (np.abs(away - track.mean[own]) > CONTRADICTED * np.sqrt(sd**2 + seen)).any():
        return track
    # The earlier drive's numbers hold the car file's already; the rest counts, and is forgotten, as
    # windows of that drive would.
    gained = DISCREPANCY * np.maximum(sd**-2.0 - space.spread[own] ** -2.0, 0.0)
    information, pull = track.information.copy(), track.pull.copy()
    information[own, own] += gained
    pull[own] += gained * away
    return Track(information, pull, track.prior)
