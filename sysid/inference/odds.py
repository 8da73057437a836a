"""What a hypothesis at its optimum is worth beside the others.

The odds are evidence times prior odds. Where the base's healthy drives were kept as controls, an
effect counts for what it gains over the base and over what healthy drives show of it, whichever is
less: what a wrong model lets it explain, it explains in the healthy drives as well.
"""

# Why: docs/decisions/diagnosis.md#d117
# Why: docs/decisions/diagnosis.md#d121
# Why: docs/decisions/diagnosis.md#d122

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect, Role
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import Control
from steerd.sysid.inference.chart import places_of
from steerd.sysid.inference.library import Library, Slice, slice_along
from steerd.sysid.inference.posterior import (
    Posterior,
    design_effect,
    log_mean,
    log_share_beyond,
    posterior_of,
)
from steerd.sysid.inference.search import Point

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects beside the base, at their optimum."""

    effects: tuple[str, ...]  # their names, in the order in which they were found
    posterior: Posterior  # the optimum, its evidence and covariance
    log_odds: float  # of the hypothesis, not normalised [nats]
    probability: float = 0.0  # among all hypotheses that were brought to their optimum

    @property
    def point(self) -> Point:
        """The optimum."""
        return self.posterior.point


def rank(
    library: Library, points: Sequence[Point], shown: "Shown | None" = None
) -> list[Hypothesis]:
    """Hypotheses at their optima with their odds, the likeliest first.

    The design effect is that under the discrepancy of the likeliest optimum, once for all.

    Args:
        library: what may be a hypothesis.
        points: their optima.
        shown: kept from call to call: what was worked out of points that have not changed.
    """
    lowest = min(points, key=lambda point: point.cost)
    temper = library.design_effect(lowest.size)
    found = {frozenset(p.space.effects): _posterior(library, p, temper, lowest) for p in points}
    evidence = {names: posterior.evidence for names, posterior in found.items()}
    if library.controls:
        coarse = design_effect(library.likelihood, lowest.size)
        alone = {frozenset(p.space.effects): _posterior(library, p, coarse, lowest) for p in points}
        evidence = _controlled(library, found, alone, temper, {} if shown is None else shown)
    ranked = [_judge(library, posterior, evidence[names]) for names, posterior in found.items()]
    return sorted(ranked, key=lambda h: -h.log_odds)


def _posterior(library: Library, point: Point, temper: float, lowest: Point) -> Posterior:
    """An optimum's posterior, no window louder beside that of lowest cost than most are.

    A car that nearly spins multiplies any small change: a few such seconds shall not show a cause.
    They count as much as the next loudest (a Winsorised sum: Tukey, The Future of Data Analysis,
    1962); of a cause that acts in one place or at a limit, which few windows see, one does. Nor
    shall one window decide between causes: the loudest on either side does not count.
    """
    posterior = posterior_of(point, temper)
    behind = np.sort(point.at.loss - lowest.at.loss)
    few, louder = max(1, round(c.LOUDEST * len(behind))), float(behind[[0, -1]].sum())
    if set(point.space.effects) < set(lowest.space.effects):
        few = 1 if any(library.effect(n).zero_gradient for n in lowest.space.effects) else few
        louder = float((behind[-few:] - behind[-few - 1 :][0]).sum())
    return replace(posterior, evidence=posterior.evidence + louder / temper)


Names = frozenset[str]
Shown = dict[tuple[Point, str], Slice | None]
"""The cost along effects, by the hypothesis that they are added to."""


def _controlled(
    library: Library,
    found: dict[Names, Posterior],
    alone: dict[Names, Posterior],
    temper: float,
    shown: Shown,
) -> dict[Names, float]:
    """Evidences that count no gain which healthy drives show as well.

    Beside the likeliest hypothesis with one effect fewer, one gains what it does beyond its
    effects' values in healthy drives. An effect without such values (its derivative vanishes at its
    null) gives up as much as any other may gain so, or counts with the design effect of drives
    without controls, whichever leaves more. Posteriors `found` are tempered by `temper`, those
    `alone` by that design effect; what is `shown` of points is added to.
    """
    level: dict[Names, float] = {}
    for names in sorted(found, key=len):
        fewer = [rest for rest in level if len(rest) == len(names) - 1]
        if not fewer:
            level[names] = found[names].evidence
            continue
        best = max(fewer, key=lambda rest: level[rest])
        more, beside = names - best, found[best].point
        whole = found[names].evidence - found[best].evidence
        whole -= sum(_healthy_gain(library, beside, name, temper, shown) for name in more)
        coarse = alone[names].evidence - alone[best].evidence
        gain = whole if more <= library.controls.keys() else max(coarse, whole)
        level[names] = min(found[names].evidence, level[best] + gain)
    return level


def _healthy_gain(library: Library, point: Point, name: str, temper: float, shown: Shown) -> float:
    """What an effect gains beside a hypothesis by being as healthy drives show it [nats].

    One without values there: the most that any other may gain so.
    """
    if name not in library.controls:
        return max(shown_most(library, control) for control in library.controls.values())
    if (point, name) not in shown:
        shown[point, name] = slice_along(library, point, library.effect(name))
    along = shown[point, name]
    if along is None:
        return 0.0
    control = library.controls[name]
    away = control.values - along.values
    gain = log_mean(along.curved / temper, along.slope / temper, away, control.covariance)
    return min(max(gain, 0.0), shown_most(library, control))


def shown_most(library: Library, control: Control) -> float:
    """The most that an effect may gain by being as healthy drives show it [nats, tempered]."""
    return c.SHOWN_MOST * len(library.likelihood.dof) * control.gain


def price(library: Library, count: int) -> float:
    """Log odds against any one hypothesis with so many effects before a drive is seen [nats]."""
    names = count * np.log(max(len(library.effects), 1))
    gap = np.log(c.GAP_ODDS) if library.known else 0.0
    return float(names + (count - 1) * np.log(c.FURTHER_ODDS) - gap) if count else 0.0


def _judge(library: Library, posterior: Posterior, evidence: float) -> Hypothesis:
    """A hypothesis with its prior odds, and the probability that its effects matter.

    An effect that ends at its null is none, whatever the base gains by what is free with it.
    """
    effects = posterior.point.space.effects
    odds = evidence - price(library, len(effects))
    for name in effects:
        effect = library.effect(name)
        far, sd = size_of(library, posterior, effect)
        odds += log_share_beyond(far, sd, 0.0, effect.least_size) if far > 0.0 else -np.inf
    return Hypothesis(effects, posterior, float(odds))


def size_of(library: Library, posterior: Posterior, effect: Effect) -> tuple[float, float]:
    """How far an effect is from what the base has of it, and the standard error of that."""
    point, augmented = posterior.point, library.likelihood.predictor.augmented
    sizes = [p.role is Role.SIZE for p in effect.parameters]
    mine = np.array(places_of(point.space.chart.free, effect.name))[sizes]
    away = point.z[mine] - np.array(augmented.values(effect.name))[sizes]
    far = float(np.linalg.norm(away))
    along = away / far if far > 0.0 else np.eye(len(away))[0]
    return far, float(np.sqrt(along @ posterior.covariance[np.ix_(mine, mine)] @ along))
