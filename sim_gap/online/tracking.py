"""Windows about a car as it was learnt, and its base's coordinates followed window by window.

About the reference each window is a quadratic form in the base's own coordinates and those of all
effects (`predictor`), so a window is evaluated once and never again. An information filter joins
them: before a window's information is added, what is known in just the directions that the window
informs is faded (Cao and Schwartz, 2000). On a straight or at a standstill no direction is
informed, and nothing fades.

What an earlier drive of the same car learnt is remembered: each number is a normal distribution,
inflated by the days since. It counts beside the first windows of a drive, not before them: a fit
that begins at a wrong car may stay there, and what these windows contradict is given up.
"""

# Why: docs/decisions/diagnosis.md#d78, docs/decisions/diagnosis.md#d87

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from steerd.sim_gap.online.samples import WINDOW
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.augmented_car import AugmentedCar
from steerd.sysid.inference.chart import places_of
from steerd.sysid.inference.likelihood import Reduced, make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.predictor import open_predictor
from steerd.sysid.inference.residuals import settled
from steerd.sysid.inference.search import stand
from steerd.sysid.inference.space import Space, informative_effects, make_space

MEMORY = 240.0  # windows until information has faded to 1/e, where others bring the same: 2 min
INFORMED = 0.05  # a window informs a direction from this share of its most informed one
DISCREPANCY = 16.0
"""Variances are this much larger than a likelihood says: what a model misses is alike from lap to
lap, and does not average out as noise does."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The car about which windows are seen."""

    augmented: AugmentedCar  # base and library, the base's values those learnt
    space: Space  # the base's coordinates first, then those of every effect that may have changed
    noise: Noise  # what is random

    @property
    def late(self) -> float:
        """How late poses are [s]."""
        return float(self.augmented.base[self.augmented.kernels.names.index("pose_delay")])

    def places(self, effect: str) -> list[int]:
        """Coordinates of an effect."""
        return places_of(self.space.chart.free, effect)


@dataclass(frozen=True, eq=False)
class Loss:
    """A window seen."""

    t: float  # when it began [s]
    square: float  # whitened squared error about the reference, at its best start
    dof: int  # its degrees of freedom
    g: Array  # (n,) pull on the coordinates (direction of steepest improvement)
    h: Array  # (n, n) information about them

    @property
    def ratio(self) -> float:
        """Whitened squared error per degree of freedom; 1 is noise."""
        return self.square / self.dof

    @property
    def weight(self) -> float:
        """What it counts: less where nothing explains it (Student's t)."""
        return 2.0 / (1.0 + self.ratio)


def may_change(augmented: AugmentedCar, runs: Sequence[Run]) -> tuple[str, ...]:
    """Effects that can come about while a car drives and show at once.

    What is a matter of a place or of the time of day is none that a window can show.
    """
    able = {e.name for e in augmented.effects if e.changes and e.at_once}
    return tuple(name for name in informative_effects(augmented, runs) if name in able)


def look(reference: Reference, run: Run, t: float) -> Loss | None:
    """See a window that began at `t` [s]; None where the reference's simulation leaves the map."""
    try:
        base, fixed = reference.augmented.base, make_space(reference.augmented, ())
        predictor = open_predictor(reference.augmented, [run], WINDOW)
        likelihood = make_likelihood(predictor, base, predictor.guess, reference.noise)
        found = settled(likelihood, fixed, fixed.centre)
        point = stand(likelihood, reference.space, reference.space.centre, found.x, 0.0)
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None
    return looks_of(point.at, [t])[0]


def looks_of(at: Reduced, times: Sequence[float]) -> list[Loss]:
    """Windows that began at these times [s], from their losses."""
    return [
        Loss(t, float(at.square[w]), int(at.dof[w]), at.g[w], at.h[w]) for w, t in enumerate(times)
    ]


@dataclass(frozen=True, eq=False)
class Track:
    """What is known of the base's coordinates, as deviations from the reference."""

    information: Array  # (n, n), prior included
    pull: Array  # (n,) information times the mean
    prior: Array  # (n, n) information before any drive

    @property
    def mean(self) -> Array:
        """(n,) the best values."""
        return np.asarray(np.linalg.solve(self.information, self.pull))

    @property
    def covariance(self) -> Array:
        """(n, n) of the coordinates, discrepancy included, never wider than the prior."""
        data = (self.information - self.prior) / DISCREPANCY + self.prior
        return np.asarray(np.linalg.inv(0.5 * (data + data.T)))


class Seen(NamedTuple):
    """A window, and what was known of the base before it."""

    before: Track
    loss: Loss


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
    """The track with one more window of pull (n,) about the reference and information (n, n).

    Both are weighed; after `memory` windows information has faded to 1/e.
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
FORGOTTEN = 0.25  # share of the car file's variance from which on a number is not remembered
MEASURED = ("lf", "lr")  # never remembered: a ruler knows them better than any lane
CONTRADICTED = 3.0  # joined standard deviations off the first windows: memory is given up


Remembered = Mapping[str, tuple[float, float]]  # (value, standard deviation) by name; SI units


class Memory(NamedTuple):
    """What was kept of an earlier drive."""

    values: Remembered  # as learnt
    days: float  # how long ago that was


def remember(augmented: AugmentedCar, memory: Memory) -> Remembered:
    """What of the memory of an earlier drive still says more than the car file's base."""
    names = [n for n in memory.values if n in augmented.kernels.names and n not in MEASURED]
    space = make_space(augmented, names)
    slopes, found = _slopes(space), {}
    for i, name in enumerate(space.chart.free[: space.nuisance]):
        value, sd = memory.values[name]
        before = float(slopes[i] * space.spread[i])
        today = float(np.hypot(sd, before * np.sqrt(PER_DAY * max(memory.days, 0.0))))
        if today**2 < FORGOTTEN * before**2:
            found[name] = value, today
    return found


def _slopes(space: Space) -> Array:
    """(n,) how fast parameters follow their own coordinates."""
    return np.abs(space.chart.own_slopes(space.centre))


def with_memory(reference: Reference, track: Track, remembered: Remembered) -> Track:
    """What first windows say of the base, joined with what an earlier drive learnt.

    The track as it was where one of the numbers contradicts these windows: it was another car.
    """
    space, at = reference.space, reference.augmented.base.copy()
    names, free = reference.augmented.kernels.names, space.chart.free[: space.nuisance]
    own = [i for i, name in enumerate(free) if name in remembered]
    for i in own:
        at[names.index(free[i])] = remembered[free[i]][0]
    away = (space.chart.coordinates(at) - space.centre)[own]
    sd = np.array([remembered[free[i]][1] for i in own]) / _slopes(space)[own]
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
