"""What changed: every effect fitted to the windows since the change, told apart as offline.

Each window is a quadratic form, its loss Student's t as in the diagnosis, so a window that nothing
explains (in which the change happened) decides nothing. The base is free within what was known of
it before; the effect pays for its prior (Laplace's evidence).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effects import find_effect
from steerd.sim_gap.engine import constants as c
from steerd.sim_gap.engine.residuals import robust_mean
from steerd.sim_gap.online.looking import Anchor, Look, cut, look_again
from steerd.sim_gap.online.tracking import Track
from steerd.sim_gap.verdict.decide import confidence_of, se_of_lead

Array = NDArray[np.float64]

CANDIDATES = 6
"""Effects whose windows are looked at again ..."""
CLOSER = (3, 5, 8, 14, 24)
"""... when there are so many."""
ROUNDS = 5
"""Times that the windows' weights are taken anew."""
SURE, SURE_WINDOWS = 0.8, 3
"""A name alone is told from this confidence and so many windows on."""
SET_WINDOWS, SET_MOST = 8, 4
"""A set of names is told from so many windows on, and if it is no larger."""
SHARE = 0.6
"""A name explains at least this share of the excess error, else the change is unexplained."""
PARTLY = 0.75
"""A name that explains less is said to explain a part, and is no surer than a part can be."""
SET_SURE = 0.6
"""Confidence below which no set of names is told."""


@dataclass(frozen=True, eq=False)
class Fit:
    """One hypothesis at its best on the windows since a change.

    Attributes:
        effect: its name, empty for the base alone.
        z: (n_base + k,) deviations from the anchor, the effect's last.
        sd: (k,) standard errors of the effect's coordinates.
        losses: (W,) of each window [nats].
        ratios: (W,) what it leaves per degree of freedom.
        cost: of the priors and of the effect's freedom [nats].
    """

    effect: str
    z: Array
    sd: Array
    losses: Array
    ratios: Array
    cost: float

    @property
    def total(self) -> float:
        """Negative log-evidence but for a constant [nats]."""
        return float(self.losses.sum()) + self.cost


@dataclass(frozen=True)
class Cause:
    """A name for a change.

    Attributes:
        effect: of the library.
        parameters: (value, standard error, unit) of each parameter by name.
        confidence: that this name, or one of `rivals`, is right (0 to 1).
        rivals: effects that these windows cannot tell from it.
    """

    effect: str
    parameters: dict[str, tuple[float, float, str]]
    confidence: float
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """What is said of a change.

    Attributes:
        verdict: `changed` (too early to tell), `named` or `unexplained`.
        cause: the likeliest effect; it is told only where it is `named`.
        gain: what it explains, over the base alone [nats].
    """

    verdict: str
    cause: Cause
    gain: float


class _Windows:
    """Windows as arrays."""

    def __init__(self, looks: Sequence[Look]) -> None:
        self.g = np.array([seen.g for seen in looks])
        self.h = np.array([seen.h for seen in looks])
        self.square = np.array([seen.square for seen in looks])
        self.dof = np.array([seen.dof for seen in looks], float)

    def ratios(self, z: Array) -> Array:
        """(W,) what is left per degree of freedom at deviations `z`."""
        bent = np.einsum("i,wij,j->w", z, self.h, z)
        left = self.square - 2.0 * self.g @ z + bent
        return np.asarray(np.maximum(left, 0.0) / self.dof)


def fit_effect(anchor: Anchor, before: Track, looks: Sequence[Look], effect: str) -> Fit:
    """One effect (or, without a name, the base alone) at its best.

    Args:
        anchor: the car.
        before: what was known of the base before the windows.
        looks: the windows, in the base's coordinates and the effect's.
        effect: of the library; empty for none.
    """
    n = anchor.space.nuisance
    own = anchor.places(effect) if effect else []
    windows = _Windows(looks)
    spread = anchor.space.spread[own]
    prior = np.zeros((n + len(own),) * 2)
    prior[:n, :n] = before.information
    prior[range(n, n + len(own)), range(n, n + len(own))] = spread**-2.0
    pull = np.concatenate([before.pull, np.zeros(len(own))])
    z = np.linalg.solve(prior, pull)
    best = z
    information = prior
    for _ in range(ROUNDS):
        weight = 2.0 / (1.0 + windows.ratios(best))
        information = prior + np.einsum("w,wij->ij", weight, windows.h)
        best = np.linalg.solve(information, pull + weight @ windows.g)
    ratios = windows.ratios(best)
    covariance = np.linalg.inv(0.5 * (information + information.T))[n:, n:]
    away = best - z
    cost = 0.5 * float(away @ prior @ away)
    if own:
        _, volume = np.linalg.slogdet(covariance / np.outer(spread, spread))
        cost -= 0.5 * float(volume)
    sd = np.sqrt(np.diag(covariance))
    return Fit(effect, best, sd, windows.dof * np.log1p(ratios), ratios, cost)


@dataclass(frozen=True, eq=False)
class Point:
    """Where an effect's windows are linearised: deviations `z`, and the windows seen from there."""

    z: Array
    looks: tuple[Look, ...]


Points = Mapping[str, Point]


def rank(
    anchor: Anchor,
    effects: Sequence[str],
    before: Track,
    looks: Sequence[Look],
    points: Points = MappingProxyType({}),
) -> tuple[Fit, list[Fit]]:
    """The base alone, and every effect whose values a car may have, the likeliest first.

    Args:
        anchor: the car.
        effects: what may have come about.
        before: what was known of the base before.
        looks: the windows since.
        points: effects whose windows were looked at again, elsewhere than at the anchor.
    """

    def seen(effect: str) -> Sequence[Look]:
        if effect in points:
            return points[effect].looks
        own = anchor.places(effect) if effect else []
        return [cut(each, [*range(anchor.space.nuisance), *own]) for each in looks]

    null = fit_effect(anchor, before, seen(""), "")
    fits = [fit_effect(anchor, before, seen(effect), effect) for effect in effects]
    possible = [fit for fit in fits if _possible(anchor, fit)] or fits
    return null, sorted(possible, key=lambda fit: fit.total)


def look_closer(
    anchor: Anchor, fits: Sequence[Fit], looks: Sequence[Look], points: Points
) -> dict[str, Point]:
    """The likeliest effects' windows looked at again.

    At the numbers `CLOSER` of windows all of them, about where the effect now is; between, the
    newest about where it was.
    """
    if len(looks) not in CLOSER:
        return {
            effect: Point(point.z, (*point.looks, look_again(anchor, looks[-1], effect, point.z)))
            for effect, point in points.items()
        }
    return {
        fit.effect: Point(
            fit.z, tuple(look_again(anchor, seen, fit.effect, fit.z) for seen in looks)
        )
        for fit in fits[:CANDIDATES]
    }


def _possible(anchor: Anchor, fit: Fit) -> bool:
    """Whether the effect's values are any that a car may have."""
    places = anchor.places(fit.effect)
    value = anchor.space.centre[places] + fit.z[anchor.space.nuisance :]
    low, high = anchor.space.low[places], anchor.space.high[places]
    return bool(((value >= low) & (value <= high)).all())


def _lead(best: Fit, other: Fit) -> tuple[float, float]:
    """How much better one fit is [nats], and the standard error of that."""
    each = np.clip(other.losses - best.losses, -c.WINSOR, c.WINSOR)
    lead = float(each.sum()) + other.cost - best.cost
    count = len(each)
    se = float(np.sqrt(count) * each.std(ddof=1)) if count > 1 else np.inf
    return lead, se_of_lead(lead, se)


def rivals_of(fits: Sequence[Fit], enough: float) -> tuple[str, ...]:
    """Effects that the windows cannot tell from the first.

    What the library calls nearly the same counts as long as it explains enough: between a plateau
    and a slope decides the form of an equation, not what a lane shows.

    Args:
        fits: every effect, the likeliest first.
        enough: whitened error that a fit which explains most leaves at most.
    """
    effect = find_effect(fits[0].effect)
    alike = effect.confounded_with.effects if effect.confounded_with is not None else ()
    found = []
    for other in fits[1:]:
        lead, se = _lead(fits[0], other)
        close = lead < c.AMBIGUOUS_SE * se + c.AMBIGUOUS_NATS
        if close or (other.effect in alike and robust_mean(other.ratios) <= enough):
            found.append(other.effect)
    if not effect.nameable_alone:
        found += alike
    return tuple(dict.fromkeys(found))


def doubt_of(fits: Sequence[Fit], spared: Sequence[str]) -> float:
    """What counts against the first name, or against it and those spared."""
    doubt = 0.0
    for other in fits[1:]:
        if other.effect not in spared:
            lead, se = _lead(fits[0], other)
            scaled = max(lead, 0.0) / (se + c.CONFIDENCE_NATS)
            doubt += float(np.exp(-2.0 * c.CONFIDENCE_SLOPE * scaled))
    return doubt


def name(anchor: Anchor, null: Fit, fits: Sequence[Fit], usual_ratio: float) -> Finding:
    """What the windows since a change say of it.

    Args:
        anchor: the car.
        null: the base alone.
        fits: every effect, see `rank`.
        usual_ratio: whitened error per degree of freedom that the car leaves when nothing is the
            matter.
    """
    best, windows = fits[0], len(null.losses)
    gain = null.total - best.total
    left, had = robust_mean(best.ratios), robust_mean(null.ratios)
    explained = (had - left) / max(had - usual_ratio, 1e-3)
    rivals = rivals_of(fits, had - PARTLY * (had - usual_ratio))
    sure = confidence_of(doubt_of(fits, rivals), partial=explained < PARTLY)
    cause = Cause(best.effect, _values(anchor, best), sure, rivals)
    alone = not rivals and windows >= SURE_WINDOWS and sure >= SURE
    together = 0 < len(rivals) < SET_MOST and windows >= SET_WINDOWS and sure >= SET_SURE
    if gain < c.GAIN_MIN or explained < SHARE or not (alone or together):
        return Finding("unexplained" if windows >= SET_WINDOWS else "changed", cause, gain)
    return Finding("named", cause, gain)


def _values(anchor: Anchor, fit: Fit) -> dict[str, tuple[float, float, str]]:
    """The effect's parameters after the change, with standard errors and units."""
    places = anchor.places(fit.effect)
    value = anchor.space.centre[places] + fit.z[anchor.space.nuisance :]
    parameters = find_effect(fit.effect).parameters
    return {
        p.name: (float(v), float(s), p.unit)
        for p, v, s in zip(parameters, value, fit.sd, strict=True)
    }
