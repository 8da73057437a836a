"""What a hypothesis at its optimum is worth beside the others.

The odds are evidence times prior odds. Where the base's healthy drives were kept as controls, an
effect counts for what it gains beyond what healthy drives show of it: what a wrong model lets it
explain, it explains in the healthy drives as well.
"""

# Why: docs/decisions/diagnosis.md#d117
# Why: docs/decisions/diagnosis.md#d121
# Why: docs/decisions/diagnosis.md#d122

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from steerd.car_model.effect import Effect, Role
from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import Control
from steerd.sysid.inference.chart import places_of
from steerd.sysid.inference.library import Library, Slice, slice_along
from steerd.sysid.inference.posterior import Posterior, log_mean, log_share_beyond, posterior_of
from steerd.sysid.inference.search import Point


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects beside the base, at their optimum."""

    effects: tuple[str, ...]  # their names, in the order in which they were found
    posterior: Posterior  # the optimum, its covariance, and of its evidence what counts
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

    Each counts for what it gains beside the likeliest of one effect fewer. The design effect is
    that under the discrepancy of the likeliest optimum, once for all. Kept from call to call
    (`shown`) is what was worked out of points that have not changed.
    """
    temper = library.design_effect(min(points, key=lambda point: point.cost).size)
    shown, level = {} if shown is None else shown, dict[Point, float]()
    found = sorted((posterior_of(point, temper) for point in points), key=_count)
    for one in found:
        level[one.point] = one.evidence
        if fewer := [other for other in found if _count(other) < _count(one)]:
            beside = max(fewer, key=lambda other: (_count(other), level[other.point]))
            gain = _counted_gain(library, beside, one, temper, shown)
            level[one.point] = level[beside.point] + gain
    counted = (replace(one, evidence=level[one.point]) for one in found)
    return sorted((_judge(library, one) for one in counted), key=lambda h: -h.log_odds)


Shown = dict[tuple[Point, str], Slice | None]
"""The cost along effects, by the hypothesis that they are added to."""


def _count(found: Posterior) -> int:
    return len(found.point.space.effects)


def _counted_gain(
    library: Library, beside: Posterior, found: Posterior, temper: float, shown: Shown
) -> float:
    """What a hypothesis gains beside one of fewer effects, no few windows' and none of the model's.

    No window is louder for it than most are, and what healthy drives show as well is left out.
    """
    start, end = beside.point, found.point
    added, gains = set(end.space.effects) - set(start.space.effects), start.at.loss - end.at.loss
    few = _winsorised(gains, any(library.effect(n).zero_gradient for n in added))
    gain = found.evidence - beside.evidence - float((gains - few).sum()) / temper
    if library.controls:
        gain -= sum(_healthy_gain(library, start, name, temper, shown) for name in added)
    return gain


def _winsorised(gains: Array, local: bool) -> Array:
    """Windows' gains, none louder than most are (Tukey, The Future of Data Analysis, 1962).

    A car that nearly spins multiplies any small change: a few such seconds shall not show a cause.
    They count as much as the next loudest; of a cause that is `local`, acts in one place or at a
    limit, which few windows see, one does.
    """
    few = 1 if local else max(1, round(c.LOUDEST * len(gains)))
    return np.asarray(np.minimum(gains, np.sort(gains)[-few - 1 :][0]))


def _healthy_gain(library: Library, point: Point, name: str, temper: float, shown: Shown) -> float:
    """What an effect gains beside a hypothesis by being as healthy drives show it [nats].

    Where no derivative shows it, or nothing is known of it: the most that it may gain so.
    """
    control = library.controls.get(name) or max(library.controls.values(), key=lambda o: o.gain)
    most = shown_most(library, control)
    if (point, name) not in shown:
        shown[point, name] = slice_along(library, point, library.effect(name))
    along = shown[point, name]
    if along is None or control.effect != name:
        return most
    away = control.values - along.values
    gain = log_mean(along.curved / temper, along.slope / temper, away, control.covariance)
    return min(max(gain, 0.0), most)


def shown_most(library: Library, control: Control) -> float:
    """The most that an effect may gain by being as healthy drives show it [nats, tempered]."""
    return c.SHOWN_MOST * len(library.likelihood.dof) * control.gain


def price(library: Library, count: int) -> float:
    """Log odds against any one hypothesis with so many effects before a drive is seen [nats]."""
    names = count * np.log(max(len(library.effects), 1))
    gap = np.log(c.GAP_ODDS) if library.known else 0.0
    return float(names + (count - 1) * np.log(c.FURTHER_ODDS) - gap) if count else 0.0


def _judge(library: Library, posterior: Posterior) -> Hypothesis:
    """A hypothesis with its prior odds, and the probability that its effects matter.

    An effect that ends at its null is none, whatever the base gains by what is free with it.
    """
    effects = posterior.point.space.effects
    odds = posterior.evidence - price(library, len(effects))
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
