"""Whether something changed, when, and what: likelihood ratios over when it may have begun.

For each effect of the library and each of the last windows: how much better the windows since then
are explained if the effect came about there, the base free within what is known of it. A model that
misses something makes windows alike that lie near each other on a lap, so a ratio is judged by what
the same car showed in as many windows while nothing was the matter (`Usual`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sim_gap.online.looking import Anchor, Look
from steerd.sim_gap.online.tracking import Track

Array = NDArray[np.float64]

SPANS: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16)
"""Numbers of windows that a change may be old."""
USUAL_PRIOR, USUAL_LEVEL = 6.0, 2.5
"""Before a car has shown anything it counts as having shown so many spans at this level."""
PEAK = 10.0
"""Largest of many ratios where all is noise, in units of their mean."""


class Span(NamedTuple):
    """Windows since a time, summed up.

    Attributes:
        pull: (n,) with what was known of the base before.
        information: (n, n) likewise.
    """

    pull: Array
    information: Array


class Suspect(NamedTuple):
    """An effect that may have come about.

    Attributes:
        effect: its name.
        windows: how many windows ago.
        gain: log-likelihood ratio [nats], the effect's prior included.
        value: (k,) its coordinates' most likely deviation.
        covariance: (k, k) of it.
    """

    effect: str
    windows: int
    gain: float
    value: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Usual:
    """What ratios a car shows while nothing is the matter.

    Attributes:
        total: (effects, spans) sum of the ratios [nats], `count` of how many.
        count: see `total`.
        peak: (effects, spans) the largest.
    """

    total: Array
    count: Array
    peak: Array

    def level(self) -> Array:
        """(effects, spans) by what a ratio is to be divided, 1 where all is noise."""
        spans = np.array(SPANS, float)
        own = self.count / spans
        mean = 2.0 * self.total / np.maximum(self.count, 1.0)
        level = (USUAL_PRIOR * USUAL_LEVEL + own * mean) / (USUAL_PRIOR + own)
        return np.asarray(np.maximum(np.maximum(level, 2.0 * self.peak / PEAK), 1.0))


def unknown(effects: int) -> Usual:
    """Nothing seen yet."""
    shape = (effects, len(SPANS))
    return Usual(np.zeros(shape), np.zeros(shape), np.zeros(shape))


def with_ratios(usual: Usual, gains: Array) -> Usual:
    """With the ratios (effects, spans) of one more window; NaN where there was no such span."""
    there = np.isfinite(gains)
    filled = np.where(there, gains, 0.0)
    return Usual(usual.total + filled, usual.count + there, np.maximum(usual.peak, filled))


def sum_up(anchor: Anchor, before: Track, looks: Sequence[Look]) -> Span:
    """Windows since a time, with what was known of the base before them."""
    n, size = anchor.space.nuisance, len(anchor.space.centre)
    pull, information = np.zeros(size), np.zeros((size, size))
    pull[:n], information[:n, :n] = before.pull, before.information
    for seen in looks:
        pull += seen.weight * seen.g
        information += seen.weight * seen.h
    return Span(pull, information)


class Marginal(NamedTuple):
    """Pull and information of all effects, the base eliminated: (m,) and (m, m)."""

    pull: Array
    information: Array


def eliminate_base(anchor: Anchor, span: Span) -> Marginal:
    """The effects' part of a span, the base at its best for each of their values."""
    n = anchor.space.nuisance
    cross = span.information[:n, n:]
    solved = np.linalg.solve(span.information[:n, :n], np.column_stack([cross, span.pull[:n]]))
    pull = span.pull[n:] - cross.T @ solved[:, -1]
    return Marginal(pull, span.information[n:, n:] - cross.T @ solved[:, :-1])


def suspect(anchor: Anchor, at: Marginal, effect: str, windows: int) -> Suspect:
    """One effect on its own, about its prior."""
    n = anchor.space.nuisance
    mine = np.array(anchor.places(effect)) - n
    own = np.ix_(mine, mine)
    spread = anchor.space.spread[n:][mine]
    precision = at.information[own] + np.diag(spread**-2)
    covariance = np.linalg.inv(0.5 * (precision + precision.T))
    value = covariance @ at.pull[mine]
    gain = 0.5 * float(at.pull[mine] @ value)
    return Suspect(effect, windows, gain, value, covariance)


def suspects(
    anchor: Anchor, effects: Sequence[str], tracks: Sequence[Track], looks: Sequence[Look]
) -> list[list[Suspect]]:
    """Every effect over every span that the windows hold, in the order of `SPANS`.

    Args:
        anchor: the car.
        effects: what is looked at.
        tracks: what was known of the base before each of the windows.
        looks: the last windows, oldest first.
    """
    found = []
    for windows in SPANS:
        if windows > len(looks):
            break
        span = sum_up(anchor, tracks[-windows], looks[-windows:])
        at = eliminate_base(anchor, span)
        found.append([suspect(anchor, at, effect, windows) for effect in effects])
    return found


def ratios(found: Sequence[Sequence[Suspect]], effects: int) -> Array:
    """(effects, spans) gains, NaN for spans longer than the windows width back."""
    table = np.full((effects, len(SPANS)), np.nan)
    for column, row in enumerate(found):
        table[:, column] = [each.gain for each in row]
    return table


def usual_of(anchor: Anchor, effects: Sequence[str], track: Track, looks: Sequence[Look]) -> Usual:
    """What the windows that made the anchor show."""
    usual = unknown(len(effects))
    for end in range(1, len(looks) + 1):
        part = looks[max(0, end - SPANS[-1]) : end]
        found = suspects(anchor, effects, [track] * len(part), part)
        usual = with_ratios(usual, ratios(found, len(effects)))
    return usual


def faded(usual: Usual, share: float) -> Usual:
    """With its peaks a little lower and its sums a little lighter."""
    keep = 1.0 - share
    return replace(
        usual, total=keep * usual.total, count=keep * usual.count, peak=keep * usual.peak
    )
