"""From hypotheses to a verdict: is there a gap, what are its names, what else, how sure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from steerd.car_model.effect import Confounding, Role, Stage
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.chart import places_of
from steerd.sysid.inference.hypotheses import Findings, is_lost, leaves_gap
from steerd.sysid.inference.library import Library
from steerd.sysid.inference.odds import Hypothesis


class Estimated(NamedTuple):
    """A parameter's value, its standard error and the unit of both."""

    value: float
    sd: float
    unit: str


@dataclass(frozen=True)
class Cause:
    """One named effect."""

    effect: str  # its name; `stage` and `family` of it
    stage: str
    family: str
    # By name; without what the base's healthy drives show of them, which is the model's error
    parameters: dict[str, Estimated]
    confidence: float  # posterior probability that it is a cause (0 to 1)
    ambiguous_with: tuple[str, ...]  # effects that may be what it stands for
    alias: str  # what no drive distinguishes from it, in words; empty if nothing


@dataclass(frozen=True)
class Verdict:
    """What the hypotheses say together."""

    name: str  # `none`, `explained`, `partial`, `unexplained` or `unjudged`
    causes: tuple[Cause, ...]  # named effects, first the one without which the odds fall most
    something_else: float  # posterior probability that no effect of the library is a cause
    left: float  # share of the gap's size that stays
    strain: float  # how far the base moved beside the causes, see `base_strain`
    at_bound: tuple[str, ...]  # named effects with a value at a bound


def judge_case(library: Library, found: Findings, known: bool) -> Verdict:
    """The verdict; where noise is not `known` from other drives, a gap passes for it."""
    best = found.best
    left = 1.0 if is_lost(best.point) else _left(found)
    stays = leaves_gap(best.point) and known
    own = library.likelihood.left  # what the base leaves in its own drives is no new gap
    nameless = "unjudged" if own > c.GAP_SIZE and found.start.size <= own else "unexplained"
    strain = base_strain(best)
    places, values = library.likelihood.predictor.augmented.places, best.point.parameters
    bounded = {n: library.effect(n).is_at_bound(values[places(n)].tolist()) for n in best.effects}
    extreme = tuple(n for n in best.effects if bounded[n])
    if not best.effects:
        return Verdict(nameless if stays else "none", (), best.probability, left, strain, ())
    # What stays of the discrepancy's variance is something else's, whatever the names gain.
    kept = 1.0 - min(left, 1.0) ** 2
    name = "partial" if stays or strain > c.STRAINED or extreme else "explained"
    name = nameless if known and left > c.HALF else name
    odds = {frozenset(h.effects): h.log_odds for h in found.hypotheses}
    without = {n: odds.get(frozenset(best.effects) - {n}, -np.inf) for n in best.effects}
    named = sorted(without, key=without.__getitem__)
    causes = tuple(_cause(library, found, effect, kept) for effect in named)
    other = 1.0 - kept * (1.0 - found.null.probability)
    return Verdict(name, () if name == nameless else causes, other, left, strain, extreme)


def _left(found: Findings) -> float:
    """Share of the gap's size that stays: of the likeliest sizes, or of the errors beyond noise.

    Where most windows are too far off to count, or the gap is none that a push could make, the
    likeliest size is far smaller than the gap.
    """
    before, after = np.sqrt(found.excess)
    sizes = [(found.start.size, found.best.point.size, c.SIZE_SMALL), (before, after, 0.0)]
    shares = [float(stays / was) for was, stays, least in sizes if was > least]
    return min(shares, default=float(found.best.point.size > c.SIZE_SMALL))


def base_strain(best: Hypothesis) -> float:
    """How far the base moved beside the effects, against what its uncertainty lets it.

    Its squared Mahalanobis distance less its mean, in standard deviations of chi-square.
    """
    n = best.point.space.nuisance
    square = 2.0 * best.point.space.base_cost(best.point.z)
    return (square - n) / float(np.sqrt(2.0 * n)) if n else 0.0


def _cause(library: Library, found: Findings, name: str, kept: float) -> Cause:
    effect, best = library.effect(name), found.best
    augmented, control = library.likelihood.predictor.augmented, library.controls.get(name)
    values = best.point.parameters[augmented.places(name)]
    square = np.diag(best.posterior.covariance)[places_of(best.point.space.chart.free, name)]
    own = np.array(augmented.values(name))
    if control is not None and not effect.zero_gradient:  # the model errs here as in healthy drives
        low, high = np.array([(p.low, p.high) for p in effect.parameters]).T
        values = np.clip(values - (control.values - own), low, high)
        square = square + np.diag(control.covariance)
    sizes = np.array([p.role is Role.SIZE for p in effect.parameters])
    least = np.minimum(np.abs(values), np.abs(values - own))
    wrong = c.MODEL_ERROR_FORCES if effect.stage is Stage.FORCES else c.MODEL_ERROR
    square = square + sizes * (wrong * least) ** 2
    parameters = {
        p.name: Estimated(float(value), float(sd), p.unit)
        for p, value, sd in zip(effect.parameters, values, np.sqrt(square), strict=True)
    }
    confounded = effect.confounded_with or Confounding(())
    confidence = kept * found.probability(name)
    others = _stand_ins(found.hypotheses, best, name)
    if confounded.alike:
        others = tuple(dict.fromkeys([*others, *confounded.effects]))
        confidence = min(confidence, c.ALIKE_MOST)
    where = effect.stage.value, effect.family
    return Cause(name, *where, parameters, confidence, others, confounded.note)


def _stand_ins(hypotheses: Sequence[Hypothesis], best: Hypothesis, name: str) -> tuple[str, ...]:
    """Effects of hypotheses without the named one that are not much less likely."""
    least = c.STANDS_IN * best.probability
    likely = [h for h in hypotheses if name not in h.effects and h.probability > least]
    names = [other for h in likely for other in h.effects if other not in best.effects]
    return tuple(dict.fromkeys(names))
