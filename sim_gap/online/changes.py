"""Whether something changed, when, and what: likelihood ratios over when it may have begun.

For each effect of the library and each of the last windows: how much better the windows since then
are explained if the effect came about there, the base free within what is known of it. A model that
misses something makes windows alike that lie near each other on a lap, so a ratio is judged by what
the same car showed in as many windows while nothing was the matter (`QuietRatios`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from steerd.sim_gap.online.tracking import Reference, Seen
from steerd.sysid.data.data_checks import Array, Indices

SPANS: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16)  # numbers of windows that a change may be old
USUAL_PRIOR, USUAL_LEVEL = 6.0, 2.5
"""Before a car has shown anything it counts as having shown so many spans at this level."""
PEAK = 10.0  # largest of many ratios where all is noise, in units of their mean
NEARLY = 6.0
"""Ratios per what is usual from which on they are weighed again as the change would have it [nats];
quiet drives get there every few minutes ..."""
LEADERS, LONGEST = 4, 6
"""... for so many effects, over spans of so many windows: what is older needs no hurry."""
ROUNDS = 6  # times that the windows' weights are taken anew


@dataclass(frozen=True, eq=False)
class QuietRatios:
    """What ratios a car shows while nothing is the matter."""

    total: Array  # (effects, spans) sum of the ratios [nats], `count` of how many
    count: Array  # see `total`
    peak: Array  # (effects, spans) the largest

    def level(self) -> Array:
        """(effects, spans) by what a ratio is to be divided, 1 where all is noise."""
        spans = np.array(SPANS, float)
        own = self.count / spans
        mean = 2.0 * self.total / np.maximum(self.count, 1.0)
        level = (USUAL_PRIOR * USUAL_LEVEL + own * mean) / (USUAL_PRIOR + own)
        return np.asarray(np.maximum(np.maximum(level, 2.0 * self.peak / PEAK), 1.0))

    def after(self, gains: Array, fading: float = 0.0) -> "QuietRatios":
        """With the ratios (effects, spans) of one more window; NaN where there was no such span.

        Its peaks are a little lower before, and its sums a little lighter, by this share.
        """
        there, keep = np.isfinite(gains), 1.0 - fading
        new = np.where(there, gains, 0.0)
        total, count = keep * self.total + new, keep * self.count + there
        return QuietRatios(total, count, np.maximum(keep * self.peak, new))


def ratios(reference: Reference, seen: Sequence[Seen]) -> Array:
    """(effects, spans) log-likelihood ratio of each effect since so many windows [nats].

    The effect's prior is included; NaN for spans longer than the windows, the last ones, reach
    back.
    """
    effects, n = reference.space.effects, reference.space.nuisance
    own = [np.array(reference.places(effect)) - n for effect in effects]
    table = np.full((len(effects), len(SPANS)), np.nan)
    for column, windows in enumerate(SPANS):
        if windows <= len(seen):
            pull, information = _without_base(reference, seen[-windows:])
            table[:, column] = [_gain(reference, pull, information, mine) for mine in own]
    return table


def _without_base(reference: Reference, seen: Sequence[Seen]) -> tuple[Array, Array]:
    """Pull (m,) and information (m, m) of all effects, the base at its best beside each."""
    n, size = reference.space.nuisance, len(reference.space.centre)
    pull, information = np.zeros(size), np.zeros((size, size))
    pull[:n], information[:n, :n] = seen[0].before.pull, seen[0].before.information
    for _, window in seen:
        pull += window.weight * window.g
        information += window.weight * window.h
    cross = information[:n, n:]
    solved = np.linalg.solve(information[:n, :n], np.column_stack([cross, pull[:n]]))
    return pull[n:] - cross.T @ solved[:, -1], information[n:, n:] - cross.T @ solved[:, :-1]


def _gain(reference: Reference, pull: Array, information: Array, mine: Indices) -> float:
    """What one effect gains at its most likely value [nats]."""
    spread = reference.space.spread[reference.space.nuisance :][mine]
    precision = information[np.ix_(mine, mine)] + np.diag(spread**-2)
    value = np.linalg.solve(0.5 * (precision + precision.T), pull[mine])
    return 0.5 * float(pull[mine] @ value)


def reweighted(reference: Reference, seen: Sequence[Seen], table: Array, level: Array) -> Array:
    """The table of `ratios`, those that are nearly a change as the change itself would have them.

    The sums weigh a window by how badly the reference explains it, so one that shows a change
    plainly counts for as little as one that nothing explains. No ratio becomes smaller. What is
    nearly a change is judged by the ratios' `QuietRatios.level`.
    """
    # Why: docs/decisions/diagnosis.md#d98
    judged = np.nan_to_num(table / level, nan=-np.inf).max(axis=1)
    if judged.max() < NEARLY:
        return table
    table = table.copy()
    leaders = np.argsort(-judged, kind="stable")[:LEADERS]
    for column, windows in enumerate(SPANS):
        if windows <= min(LONGEST, len(seen)):
            since = seen[-windows:]
            null = _cost(reference, since, [])
            for row in leaders:
                own = reference.places(reference.space.effects[row])
                gain = null - _cost(reference, since, own)
                table[row, column] = max(table[row, column], gain)
    return table


def _cost(reference: Reference, seen: Sequence[Seen], own: Sequence[int]) -> float:
    """Loss of windows and prior at the best of the base and some coordinates [nats].

    Student's t with weights at the fit; infinite where no car has such values. Windows that the
    reference explains badly barely pull, so a large effect that explains them all is looked for
    from equal weights too.
    """
    space, n, before = reference.space, reference.space.nuisance, seen[0].before
    looks, at = [window for _, window in seen], [*range(n), *own]
    prior = np.diag(space.spread[at] ** -2)
    prior[:n, :n] = before.information
    pull = np.concatenate([before.pull, np.zeros(len(own))])
    g = np.array([look.g[at] for look in looks])
    h = np.array([look.h[np.ix_(at, at)] for look in looks])
    square = np.array([look.square for look in looks])
    dof = np.array([look.dof for look in looks])
    costs = []
    for first in (square / dof, np.ones(len(looks))):
        z, left = np.zeros(len(at)), first
        for _ in range(ROUNDS):
            weight = 2.0 / (1.0 + left)
            z = np.linalg.solve(prior + np.tensordot(weight, h, 1), pull + weight @ g)
            left = np.maximum(square - 2.0 * g @ z + (h @ z) @ z, 0.0) / dof
        value, away = (space.centre[at] + z)[n:], z - np.linalg.solve(prior, pull)
        if ((space.low[at][n:] <= value) & (value <= space.high[at][n:])).all():
            costs.append(float(dof @ np.log1p(left)) + 0.5 * float(away @ prior @ away))
    return min(costs, default=np.inf)


def quiet_ratios_of(reference: Reference, seen: Sequence[Seen]) -> QuietRatios:
    """What the windows that made the reference show."""
    usual = QuietRatios(*np.zeros((3, len(reference.space.effects), len(SPANS))))
    for end in range(1, len(seen) + 1):
        usual = usual.after(ratios(reference, seen[max(0, end - SPANS[-1]) : end]))
    return usual
