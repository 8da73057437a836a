"""What changed: the fitted effects distinguished as in the offline diagnosis."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effects import find_effect
from steerd.sim_gap.online.fitting import Fit, Points, alike_to, is_at_bound
from steerd.sim_gap.online.looking import Anchor
from steerd.sysid.inference.residuals import robust_mean

Array = NDArray[np.float64]

ALIKE = 0.5
"""Share of the excess from which a tyre that the library calls nearly the same stays one."""
TYRES = "tyre"
"""Family of effects of which a lane shows the amount, and not the form."""
UNSEEN = 0.5
"""Share of the best effect's gain from which one not looked at again stays an alternative."""
SURE, SURE_WINDOWS = 0.8, 3
"""A name alone is reported from this confidence and so many windows on."""
SETTLED = 16
"""Windows after which the name of a change counts: eight seconds, a lap of a small eight."""
SET_WINDOWS, SET_MOST = 8, 4
"""A set of names is reported from so many windows on, and if it is no larger."""
SHARE = 0.6
"""A name explains at least this share of the excess error, else the change is unexplained."""
PARTLY = 0.75
"""A name that explains less is said to explain a part, and is no surer than a part can be."""
SET_SURE = 0.6
"""Confidence below which no set of names is reported."""
WINSOR = 50.0
"""One window counts for no more than this many nats."""
GAIN_MIN = 10.0
"""Gain below which nothing is named [nats]."""
AMBIGUOUS_SE, AMBIGUOUS_NATS = 2.5, 3.0
"""An effect whose fit lies no further behind than so many standard errors and nats stays one."""
CONFIDENCE_SLOPE, CONFIDENCE_NATS = 0.8, 4.0
"""A fit counts exp(-2 slope lead / (standard error + nats)) against the first name."""
DOUBT_LEAST = 0.01
"""Fits further behind than this count as so far."""
CONFIDENCE_AT_ONE, CONFIDENCE_PER_SURETY, CONFIDENCE_PARTIAL = 0.6, 0.6, -0.8
"""Log-odds of a name: at a doubt of 1, per e-fold less, and where part of the error stays. A
logistic regression on 92 names of the blind test's tuning sets 21 and 22."""
PARTIAL_MOST = 0.75
"""No name is surer while part of the error has none: what makes that part may make it all."""


@dataclass(frozen=True)
class Cause:
    """A name for a change.

    Attributes:
        effect: of the library.
        parameters: (value, standard error, unit) of each parameter by name.
        confidence: that this name, or one of `alternatives`, is right (0 to 1).
        alternatives: effects that these windows cannot distinguish from it.
    """

    effect: str
    parameters: dict[str, tuple[float, float, str]]
    confidence: float
    alternatives: tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """What is said of a change.

    Attributes:
        verdict: `changed` (too early to say), `named` or `unexplained`.
        cause: the likeliest effect; it is reported only where it is `named`.
        gain: what it explains, over the base alone [nats].
    """

    verdict: str
    cause: Cause
    gain: float


def _lead(best: Fit, other: Fit) -> tuple[float, float]:
    """How much better one fit is [nats], and the standard error of that."""
    each = np.clip(other.losses - best.losses, -WINSOR, WINSOR)
    lead = float(each.sum()) + other.cost - best.cost
    count = len(each)
    se = float(np.sqrt(count) * each.std(ddof=1)) if count > 1 else np.inf
    return lead, se_of_lead(lead, se)


def alternatives_of(
    null: Fit, fits: Sequence[Fit], points: Points, enough: float
) -> tuple[str, ...]:
    """Effects that the windows cannot distinguish from the first.

    A tyre that the library calls nearly the same counts as long as it explains enough: between a
    plateau and a slope decides the form of an equation, not what a lane shows. Of other pairs (drag
    or speed scale, a marker or the centre of gravity) the readings decide, as of any two effects.

    An effect that was only seen from the anchor, where its form is less exact, counts as long as it
    explains a good part of what the first does.

    Args:
        null: the base alone.
        fits: every effect, the likeliest first.
        points: effects whose windows were looked at again.
        enough: whitened error that a fit which explains most leaves at most.
    """
    alike = alike_to(fits[0].effect)
    tyres = alike if find_effect(fits[0].effect).family == TYRES else ()
    found, gain = [], null.total - fits[0].total
    for other in fits[1:]:
        lead, se = _lead(fits[0], other)
        close = lead < AMBIGUOUS_SE * se + AMBIGUOUS_NATS
        close |= other.effect not in points and null.total - other.total > UNSEEN * gain
        if close or (other.effect in tyres and robust_mean(other.ratios) <= enough):
            found.append(other.effect)
    if not find_effect(fits[0].effect).nameable_alone:
        found += alike
    return tuple(dict.fromkeys(found))


def doubt_of(fits: Sequence[Fit], spared: Sequence[str]) -> float:
    """What counts against the first name, or against it and those spared."""
    doubt = 0.0
    for other in fits[1:]:
        if other.effect not in spared:
            lead, se = _lead(fits[0], other)
            scaled = max(lead, 0.0) / (se + CONFIDENCE_NATS)
            doubt += float(np.exp(-2.0 * CONFIDENCE_SLOPE * scaled))
    return doubt


def confidence_of(doubt: float, partial: bool) -> float:
    """How sure a name is.

    Args:
        doubt: see `doubt_of`.
        partial: whether part of the error stays.
    """
    surety = -float(np.log(max(doubt, DOUBT_LEAST)))
    odds = CONFIDENCE_AT_ONE + CONFIDENCE_PER_SURETY * surety + CONFIDENCE_PARTIAL * partial
    return min(float(1.0 / (1.0 + np.exp(-odds))), PARTIAL_MOST if partial else 1.0)


def se_of_lead(lead: float, se: float) -> float:
    """Standard error of a paired lead, no larger than twice a likelihood ratio's own."""
    return min(se, 2.0 * float(np.sqrt(2.0 * max(lead, 1.0))))


def name(
    anchor: Anchor,
    null: Fit,
    fits: Sequence[Fit],
    usual_ratio: float,
    points: Points = MappingProxyType({}),
) -> Finding:
    """What the windows since a change say of it.

    Args:
        anchor: the car.
        null: the base alone.
        fits: every effect, see `rank`.
        usual_ratio: whitened error per degree of freedom that the car leaves when nothing is the
            matter.
        points: effects whose windows were looked at again.
    """
    best, windows = fits[0], len(null.losses)
    gain = null.total - best.total
    left, had = robust_mean(best.ratios), robust_mean(null.ratios)
    explained = (had - left) / max(had - usual_ratio, 1e-3)
    alternatives = alternatives_of(null, fits, points, had - ALIKE * (had - usual_ratio))
    sure = confidence_of(doubt_of(fits, alternatives), partial=explained < PARTLY)
    cause = Cause(best.effect, values_after(anchor, best), sure, alternatives)
    alone = not alternatives and windows >= SURE_WINDOWS and sure >= SURE
    together = 0 < len(alternatives) < SET_MOST and windows >= SET_WINDOWS and sure >= SET_SURE
    extreme = is_at_bound(anchor, best)
    if gain < GAIN_MIN or explained < SHARE or extreme or not (alone or together):
        return Finding("unexplained" if windows >= SET_WINDOWS else "changed", cause, gain)
    return Finding("named", cause, gain)


def values_after(anchor: Anchor, fit: Fit) -> dict[str, tuple[float, float, str]]:
    """The effect's parameters after the change, with standard errors and units."""
    places = anchor.places(fit.effect)
    value = anchor.space.centre[places] + fit.z[anchor.space.nuisance :]
    parameters = find_effect(fit.effect).parameters
    return {
        p.name: (float(v), float(s), p.unit)
        for p, v, s in zip(parameters, value, fit.sd, strict=True)
    }
