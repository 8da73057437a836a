"""Every effect fitted to the windows since a change.

Each window is a quadratic form, its loss Student's t as in the diagnosis, so a window that nothing
explains (in which the change happened) decides nothing. The base is free within what was known of
it before; the effect pays for its prior (Laplace's evidence).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effects import find_effect
from steerd.sim_gap.online.looking import Anchor, Look, cut, look_again
from steerd.sim_gap.online.tracking import Track

Array = NDArray[np.float64]

CANDIDATES = 6
"""Effects whose windows are looked at again ..."""
CLOSER = (3, 5, 8, 14, 24)
"""... when there are so many."""
FIRST = (
    "steer_bias", "steer_gain", "steer_delay", "tyre_friction", "speed_scale", "mocap_yaw",
    "marker_offset",
)  # fmt: skip
"""Effects that are ordinary on a bad day: they are looked at again although others lead by far. A
steering that was at its end stop has no derivative by a gain that takes it off."""
HOPELESS = 0.2
"""Unless they explain less than this of what the leading one does."""
HALVINGS = 3
"""Times that a step which makes the windows worse than they were is halved."""
ROUNDS = 6
"""Times that the windows' weights are taken anew."""


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
        freedom: the latter alone: what it costs that the effect might have been otherwise.
    """

    effect: str
    z: Array
    sd: Array
    losses: Array
    ratios: Array
    cost: float
    freedom: float = 0.0

    @property
    def total(self) -> float:
        """Negative log-evidence but for a constant [nats]."""
        return float(self.losses.sum()) + self.cost


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


class _System(NamedTuple):
    """Windows with the prior of the coordinates: information (n, n) and pull (n,)."""

    windows: _Windows
    prior: Array
    pull: Array

    def cost(self, z: Array, centre: Array) -> float:
        """Losses and half the prior's square [nats]."""
        losses = self.windows.dof * np.log1p(self.windows.ratios(z))
        return float(losses.sum()) + 0.5 * float((z - centre) @ self.prior @ (z - centre))

    def solve(self, z: Array, free: NDArray[np.int64]) -> tuple[Array, Array]:
        """The best values of some coordinates, the others held; and the information there.

        Windows that the start explains badly barely pull, so a large effect that explains them all
        is looked for from equal weights too.
        """
        ends = [self._iterate(z, free, even) for even in (False, True)]
        return min(ends, key=lambda end: self.cost(end[0], z))

    def _iterate(self, z: Array, free: NDArray[np.int64], even: bool) -> tuple[Array, Array]:
        information = self.prior
        for turn in range(ROUNDS):
            weight = 2.0 / (1.0 + self.windows.ratios(z))
            if even and turn == 0:
                weight = np.ones_like(weight)
            information = self.prior + np.einsum("w,wij->ij", weight, self.windows.h)
            slope = self.pull + weight @ self.windows.g - information @ z
            z = z.copy()
            z[free] += np.linalg.solve(information[np.ix_(free, free)], slope[free])
        return z, information


def _inside(anchor: Anchor, places: Sequence[int], away: Array) -> Array:
    """An effect's deviations, moved to where a car may be."""
    centre, at = anchor.space.centre[list(places)], list(places)
    low, high = anchor.space.low[at] - centre, anchor.space.high[at] - centre
    return np.asarray(np.clip(away, low, high))


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
    system = _System(windows, prior, pull)
    best, information = system.solve(z, np.arange(len(z)))
    held = _inside(anchor, own, best[n:])
    if (held != best[n:]).any():
        best, _ = system.solve(np.concatenate([best[:n], held]), np.arange(n))
    ratios = windows.ratios(best)
    covariance = np.linalg.inv(0.5 * (information + information.T))[n:, n:]
    away = best - z
    cost, freedom = 0.5 * float(away @ prior @ away), 0.0
    if own:
        _, volume = np.linalg.slogdet(covariance / np.outer(spread, spread))
        freedom = -0.5 * float(volume)
    sd = np.sqrt(np.diag(covariance))
    losses = windows.dof * np.log1p(ratios)
    return Fit(effect, best, sd, losses, ratios, cost + freedom, freedom)


@dataclass(frozen=True, eq=False)
class Point:
    """Where an effect's windows are linearised: deviations `z`, and the windows seen from there."""

    z: Array
    looks: tuple[Look, ...]


Points = Mapping[str, Point]


def looks_for(
    anchor: Anchor, effect: str, looks: Sequence[Look], points: Points = MappingProxyType({})
) -> Sequence[Look]:
    """The windows in the base's coordinates and an effect's, looked at again where they were."""
    if effect in points:
        return points[effect].looks
    own = anchor.places(effect) if effect else []
    return [cut(each, [*range(anchor.space.nuisance), *own]) for each in looks]


def rank(
    anchor: Anchor,
    effects: Sequence[str],
    before: Track,
    looks: Sequence[Look],
    points: Points = MappingProxyType({}),
) -> tuple[Fit, list[Fit]]:
    """The base alone, and every effect within what a car may have, the likeliest first.

    Args:
        anchor: the car.
        effects: what may have come about.
        before: what was known of the base before.
        looks: the windows since.
        points: effects whose windows were looked at again, elsewhere than at the anchor.
    """
    null, *fits = (
        fit_effect(anchor, before, looks_for(anchor, effect, looks, points), effect)
        for effect in ("", *effects)
    )
    return null, sorted(fits, key=lambda fit: fit.total)


def look_closer(
    anchor: Anchor, null: Fit, fits: Sequence[Fit], looks: Sequence[Look], points: Points
) -> dict[str, Point]:
    """The likeliest effects' windows looked at again.

    At the numbers `CLOSER` of windows all of them, about where the effect now is; between, the
    newest about where it was.
    """
    if len(looks) not in CLOSER:
        return {effect: _longer(anchor, effect, point, looks) for effect, point in points.items()}
    return {
        fit.effect: _closer(anchor, fit, looks, points.get(fit.effect))
        for fit in worth_a_look(null, fits)
    }


def _longer(anchor: Anchor, effect: str, point: Point, looks: Sequence[Look]) -> Point:
    """The same point with the windows that it has not seen yet."""
    late = looks[len(point.looks) :]
    again = tuple(look_again(anchor, seen, effect, point.z) for seen in late)
    return Point(point.z, (*point.looks, *again))


def _closer(anchor: Anchor, fit: Fit, looks: Sequence[Look], old: Point | None) -> Point:
    """The windows about where the effect now is, or less far where that fits them worse.

    A form is exact only where it was made: a tyre that slides is no straight line away from one
    that grips, and a hypothesis that stands where no car drives loses to whatever is next to it.
    """
    n, own = anchor.space.nuisance, anchor.places(fit.effect)
    if old is None:
        at = tuple(cut(seen, [*range(n), *own]) for seen in looks)
        old = Point(np.zeros(n + len(own)), at)
    else:
        old = _longer(anchor, fit.effect, old, looks)
    z = fit.z.copy()
    if is_at_bound(anchor, fit):  # the form reaches too far; half of it is a car that drives
        z[n:] *= 0.5
    for _ in range(HALVINGS):
        new = Point(z, tuple(look_again(anchor, seen, fit.effect, z) for seen in looks))
        if _exact(new) <= _exact(old):
            return new
        z = 0.5 * (z + old.z)
    return old


def _exact(point: Point) -> float:
    """Loss of a point's windows where they were linearised, where their form is exact [nats]."""
    windows = _Windows(point.looks)
    return float((windows.dof * np.log1p(windows.ratios(point.z))).sum())


def worth_a_look(null: Fit, fits: Sequence[Fit]) -> list[Fit]:
    """Effects that lead, that are nearly the same as the first, or that are ordinary."""
    most = null.total - fits[0].total
    alike = alike_to(fits[0].effect)
    ordinary = [f for f in fits if f.effect in FIRST and null.total - f.total > HOPELESS * most]
    return [
        fit
        for place, fit in enumerate(fits)
        if place < CANDIDATES or fit.effect in alike or fit in ordinary
    ]


def is_at_bound(anchor: Anchor, fit: Fit) -> bool:
    """Whether the effect would have to be larger than on any car: it makes up for another."""
    away = fit.z[anchor.space.nuisance :]
    width = 1.0 + 1e-9
    return bool((_inside(anchor, anchor.places(fit.effect), width * away) != width * away).any())


def alike_to(effect: str) -> tuple[str, ...]:
    """Effects that the library calls nearly the same."""
    known = find_effect(effect).confounded_with
    return known.effects if known is not None else ()
