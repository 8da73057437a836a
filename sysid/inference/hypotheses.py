"""Which effects: every hypothesis from the base at its prior, under a discrepancy like the gap.

A hypothesis is a set of effects beside the base. Each is looked at from where nothing has moved
yet, under the discrepancy that the base at its prior needs; the likeliest are brought to their
optimum. No hypothesis may be worse than one nested in it: bases are exchanged until none is.
"""

# Why: docs/decisions/diagnosis.md#d117
# Why: docs/decisions/diagnosis.md#d118

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect, Role
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.likelihood import SIZES, Likelihood, Weighed, loss_of
from steerd.sysid.inference.places import suspicious_discs
from steerd.sysid.inference.posterior import (
    Posterior,
    design_effect,
    log_share_beyond,
    posterior_of,
)
from steerd.sysid.inference.residuals import robust_mean
from steerd.sysid.inference.search import (
    Point,
    explore,
    minimise,
    newton,
    open_point,
    stand,
    with_size,
)
from steerd.sysid.inference.space import Space, make_space

Array = NDArray[np.float64]

_LADDER = (-1.5, -0.5, 0.5, 1.5)
"""Values that are tried, in prior scales of the parameter off what the base has."""
_SCREEN_SIZES = (1.0, 0.3, 0.1)
"""Shares of the starting size at which effects are screened."""
_SCREEN_SHARE = 0.4
"""An effect whose expected gain is less than this share of what a name needs is not fitted."""
_WORSE = 0.5
"""Nats by which a hypothesis counts as worse than another."""


@dataclass(frozen=True, eq=False)
class Library:
    """What may be a hypothesis.

    Attributes:
        likelihood: the windows.
        nuisance: the base's free parameters.
        effects: what may be added to it.
        known: whether the base's prior is knowledge from other drives, which windows whose errors
            repeat outweigh no sooner than as many independent ones as they are worth.
    """

    likelihood: Likelihood
    nuisance: tuple[str, ...]
    effects: tuple[Effect, ...]
    known: bool = True

    def space(self, names: Sequence[str]) -> Space:
        """Coordinates of a hypothesis: the base's, then its effects'."""
        augmented = self.likelihood.predictor.augmented
        gone = {same for e in augmented.effects if e.name in names for same in e.same_as}
        kept = [name for name in self.nuisance if name not in gone]
        return make_space(augmented, kept, names).heavier(self.worth)

    @cached_property
    def worth(self) -> float:
        """How many windows are worth one where nothing is left but noise."""
        return design_effect(self.likelihood, 0.0) if self.known else 1.0

    def effect(self, name: str) -> Effect:
        """An effect by name."""
        return next(e for e in self.likelihood.predictor.augmented.effects if e.name == name)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects beside the base, at their optimum.

    Attributes:
        effects: their names, in the order in which they were found.
        posterior: the optimum, its evidence and covariance.
        log_odds: of the hypothesis, not normalised [nats].
        probability: among all hypotheses that were brought to their optimum.
    """

    effects: tuple[str, ...]
    posterior: Posterior
    log_odds: float
    probability: float = 0.0

    @property
    def point(self) -> Point:
        """The optimum."""
        return self.posterior.point


@dataclass(frozen=True, eq=False)
class Findings:
    """All hypotheses that were brought to an optimum, the likeliest first.

    Attributes:
        hypotheses: see there.
        start: the base at its prior, under the discrepancy that it needs.
        temper: the case's design effect.
        untested: effects whose simulation does not stay finite.
        covering: the least sizes that bring errors down to noise, at the start and at the best.
    """

    hypotheses: tuple[Hypothesis, ...]
    start: Point
    temper: float
    untested: tuple[str, ...]
    covering: tuple[float, float]

    @property
    def best(self) -> Hypothesis:
        """The likeliest."""
        return self.hypotheses[0]

    @property
    def null(self) -> Hypothesis:
        """The base alone: nothing, or something else than the library."""
        return next(h for h in self.hypotheses if not h.effects)

    def probability(self, effect: str) -> float:
        """That an effect is a cause."""
        return float(sum(h.probability for h in self.hypotheses if effect in h.effects))


@dataclass(eq=False)
class _Search:
    """Hypotheses at their optima so far, by their effects."""

    library: Library
    pool: dict[frozenset[str], Point] = field(default_factory=dict)
    untested: set[str] = field(default_factory=set)
    explored: set[tuple[str, ...]] = field(default_factory=set)
    exchanged: set[tuple[tuple[str, ...], tuple[str, ...], int]] = field(default_factory=set)

    @property
    def likelihood(self) -> Likelihood:
        return self.library.likelihood

    @cached_property
    def surprise(self) -> float:
        """What a first name must gain before its odds are even, not tempered [nats]."""
        return float(np.log(max(len(self.library.effects), 1)))

    def temper(self) -> float:
        """The design effect under the likeliest optimum's discrepancy."""
        lowest = min(self.pool.values(), key=lambda point: point.cost)
        return design_effect(self.likelihood, lowest.size)

    def hypotheses(self) -> list[Hypothesis]:
        """All of them with their odds, the likeliest first."""
        temper = self.temper()
        lowest = min(self.pool.values(), key=lambda point: point.cost)
        found = [judge(self.library, point, temper, lowest) for point in self.pool.values()]
        return sorted(found, key=lambda h: -h.log_odds)

    def keep(self, point: Point | None) -> None:
        """Keep an optimum if it is the best of its hypothesis so far."""
        if point is None:
            return
        key = frozenset(point.space.effects)
        if key not in self.pool or point.cost < self.pool[key].cost:
            self.pool[key] = point

    def grow(self, start: Point, most: int, further: bool) -> None:
        """A hypothesis at its optimum, and the likeliest with one effect more.

        Args:
            start: the hypothesis with its base at the prior.
            most: how many with an effect more.
            further: whether that is a further cause, against which odds are longer.
        """
        self.keep(_try(self.likelihood, start))
        candidates, level = screen_effects(self.library, start)
        self.untested |= {
            candidate.effect for candidate in candidates if not np.isfinite(candidate.cost)
        }
        needed = self.surprise + (np.log(c.FURTHER_ODDS) if further else 0.0)
        least = _SCREEN_SHARE * needed * design_effect(self.likelihood, 0.3 * start.size)
        chosen = [candidate for candidate in candidates if level - candidate.cost > least][:most]
        incumbent = min((point.cost for point in self.pool.values()), default=np.inf)
        for candidate in chosen:
            begun = _with_effect(self.library, start, candidate)
            point = None if begun is None else _try(self.likelihood, begun, incumbent)
            self.keep(point)
            incumbent = min(incumbent, np.inf if point is None else point.cost)
        self.exchange()
        self.explore()

    def explore(self) -> None:
        """A cause that is named, and what competes with it, from more starts."""
        ranked = self.hypotheses()
        near = [h for h in ranked if ranked[0].log_odds - h.log_odds < c.NEARLY]
        if len(near) < 2 and not ranked[0].effects:
            return
        for h in near:
            if h.effects not in self.explored:
                self.explored.add(h.effects)
                self.keep(explore(self.likelihood, h.point))
        self.exchange()

    def exchange(self) -> None:
        """Bases exchanged until no hypothesis is worse than one nested in it.

        What is nested in the best is tried from the best's base as well: what the base alone gains
        there is no effect's.
        """
        for _ in range(3):
            best = min(self.pool.values(), key=lambda point: point.cost)
            whole = frozenset(best.space.effects)
            inner = [point for names, point in self.pool.items() if names < whole]
            changed = [self._improve(point, best) for point in inner]
            for names, point in list(self.pool.items()):
                nested = [p for other, p in self.pool.items() if other < names]
                lower = min(nested, key=lambda p: p.cost, default=None)
                if lower is not None and point.cost > lower.cost - _WORSE:
                    changed.append(self._improve(point, lower))
            if not any(changed):
                return

    def _improve(self, point: Point, other: Point) -> bool:
        """A hypothesis from another's base; whether that is better.

        Where the other is nested in it and stays better, effects begin at what the base has too.
        """
        key = (point.space.effects, other.space.effects, round(other.cost))
        if key in self.exchanged:
            return False
        self.exchanged.add(key)
        space, wider = point.space, max(1.5 * other.size, c.SIZE_SMALL)
        found = self._from(space, carry(space, other, point), other, wider)
        lowest = min(point.cost, np.inf if found is None else found.cost)
        if set(other.space.effects) < set(space.effects) and lowest > other.cost + _WORSE:
            again = self._from(space, carry(space, other), other, other.size)
            found = min((p for p in (found, again) if p), key=lambda p: p.cost, default=None)
        if found is None or found.cost > point.cost - _WORSE:
            return False
        self.keep(found)
        return True

    def _from(self, space: Space, z: Array, other: Point, size: float) -> Point | None:
        """The optimum from coordinates at another hypothesis' starts."""
        begun = _stand(self.likelihood, space, z, other.x, size)
        return None if begun is None else _try(self.likelihood, begun)


def explain(
    library: Library, most: int = 2, progress: Callable[[float], None] = lambda share: None
) -> Findings:
    """The hypotheses of a case.

    Args:
        library: what may be a hypothesis.
        most: causes at most.
        progress: called with the share done.

    Raises:
        FloatingPointError: the base car's simulation diverges.
    """
    search = _Search(library)
    start = begin(library)
    search.grow(start, c.FITTED, further=False)
    best = search.hypotheses()[0]
    while 0 < len(best.effects) < most:
        progress(0.5)
        search.grow(_again(library, best.effects, best.point), c.FITTED_FURTHER, further=True)
        likeliest = search.hypotheses()[0]
        if likeliest.effects == best.effects:
            break
        best = likeliest
        for name in best.effects[: len(best.effects) if len(best.effects) > 1 else 0]:
            rest = tuple(n for n in best.effects if n != name)
            search.grow(_again(library, rest, best.point), c.FITTED_FURTHER, further=True)
        best = search.hypotheses()[0]
    found = search.hypotheses()
    odds = np.array([h.log_odds for h in found])
    share = np.exp(odds - odds.max())
    share /= share.sum()
    ranked = [replace(h, probability=float(p)) for h, p in zip(found, share, strict=True)]
    untested = tuple(sorted(search.untested))
    before, after = (covering_size(library.likelihood, p) for p in (start, ranked[0].point))
    return Findings(tuple(ranked), start, search.temper(), untested, (before, after))


def covering_size(likelihood: Likelihood, point: Point) -> float:
    """The least size under which a point's errors are no larger than noise."""
    for size in SIZES.tolist():
        at = with_size(likelihood, point, size).at
        if robust_mean(at.ratio) <= 1.0:
            return float(size)
    return float(SIZES[-1])


def begin(
    library: Library,
    names: Sequence[str] = (),
    values: Sequence[float] = (),
    x: Array | None = None,
) -> Point:
    """The base at its prior with some effects' values, under the discrepancy that this needs.

    The windows' starts are sought from `x` (W, 7), or from their first guesses.

    Raises:
        FloatingPointError: the simulation diverges there.
    """
    space, likelihood = library.space(names), library.likelihood
    z = space.centre.copy()
    z[len(z) - len(values) :] = values
    return open_point(likelihood, space, z, likelihood.predictor.guess.copy() if x is None else x)


def _again(library: Library, names: Sequence[str], point: Point) -> Point:
    """A hypothesis with its base back at the prior; its effects' values and starts stay."""
    known = dict(zip(point.space.chart.free, point.z.tolist(), strict=True))
    own = [n for n in library.space(names).chart.free if n.partition(".")[0] in names]
    try:
        return begin(library, names, [known[n] for n in own], point.x)
    except FloatingPointError:
        return point


def carry(space: Space, point: Point, own: Point | None = None) -> Array:
    """A point's values in another hypothesis' coordinates; what it lacks is as in `own`."""
    known = dict(zip(space.chart.free, space.centre.tolist(), strict=True))
    if own is not None:
        known |= dict(zip(own.space.chart.free, own.z.tolist(), strict=True))
    known |= dict(zip(point.space.chart.free, point.z.tolist(), strict=True))
    z = np.array([known[name] for name in space.chart.free])
    return np.asarray(np.clip(z, space.low, space.high))


def _stand(likelihood: Likelihood, space: Space, z: Array, x: Array, size: float) -> Point | None:
    try:
        return stand(likelihood, space, z, x, size)
    except FloatingPointError:
        return None


def _try(likelihood: Likelihood, start: Point, incumbent: float = np.inf) -> Point | None:
    """The optimum from a start; None if the simulation diverges on the way."""
    try:
        return minimise(likelihood, start, incumbent)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None


@dataclass(frozen=True)
class Candidate:
    """An effect and its expected cost, from the base at its prior.

    Attributes:
        effect: its name; `values` of its parameters to start from.
        cost: expected beside the base one step on [nats].
    """

    effect: str
    values: tuple[float, ...]
    cost: float


def screen_effects(library: Library, start: Point) -> tuple[list[Candidate], float]:
    """Every effect that the start lacks, the likeliest first, and the start's own cost.

    No window's start is held here: one that the base alone bends too far may be where an effect
    shows, and could then not follow it.
    """
    held = np.zeros_like(start.rotated.held)
    start = replace(start, rotated=start.rotated._replace(held=held))
    views = [library.likelihood.weigh(start.rotated, share * start.size) for share in _SCREEN_SIZES]
    every = np.arange(len(start.z))
    level = _expected(library, start, views, start.space, every, start.linear.error)
    left = [e for e in library.effects if e.name not in start.space.effects]
    found = []
    for effect in left:
        candidates = _candidates_of(library, start, views, effect)
        none = Candidate(effect.name, effect.nulls, np.inf)
        found.append(min(candidates, key=lambda candidate: candidate.cost, default=none))
    return sorted(found, key=lambda candidate: candidate.cost), level


def _with_effect(library: Library, start: Point, candidate: Candidate) -> Point | None:
    """The start with an effect at the values of its candidate."""
    space = library.space([*start.space.effects, candidate.effect])
    z = carry(space, start)
    z[-len(candidate.values) :] = candidate.values
    z = np.clip(z, space.low, space.high)
    return _stand(library.likelihood, space, z, start.x, start.size)


def _candidates_of(
    library: Library, start: Point, views: Sequence[Weighed], effect: Effect
) -> Iterable[Candidate]:
    """An effect at several values, the base stepped once beside each."""
    space = library.space([*start.space.effects, effect.name])
    own = slice(len(space.centre) - len(effect.parameters), None)
    names = space.chart.free[: own.start]
    keep = np.array([start.space.chart.free.index(name) for name in names])
    nulls = space.centre[own].tolist()
    for values in [*_ladder(start, effect, nulls), *_linear(library, start, effect, space, keep)]:
        z = carry(space, start)
        z[own] = values
        z = np.clip(z, space.low, space.high)
        error, finite = library.likelihood.predictor.errors(space.chart.parameters(z), start.x)
        if finite:
            cost = _expected(library, start, views, space, keep, error)
            yield Candidate(effect.name, tuple(z[own].tolist()), cost)


def _expected(
    library: Library,
    start: Point,
    views: Sequence[Weighed],
    space: Space,
    keep: NDArray[np.int64],
    error: Array,
) -> float:
    """Cost at the best of a few sizes after one step of the base, with the start's derivatives."""
    precision = library.worth * np.linalg.inv(space.covariance[: len(keep), : len(keep)])
    best = np.inf
    for view in views:
        at = library.likelihood.reduce(view, error, start.x)
        g, h = at.g[:, keep], at.h[:, keep[:, None], keep]
        dz = np.linalg.solve(np.tensordot(at.weight, h, 1) + precision, at.weight @ g)
        square = at.square - 2.0 * g @ dz + ((h @ dz) * dz).sum(axis=1)
        loss = loss_of(square, at.dof) + at.volume
        best = min(best, float(loss.sum()) + 0.5 * float(dz @ precision @ dz))
    return best


def _ladder(start: Point, effect: Effect, nulls: Sequence[float]) -> list[tuple[float, ...]]:
    """Values worth trying about what the base has of the effect."""
    if effect.scan is not None:
        x, at = start.x, start.at
        ahead = 0.5 * x[:, 3:4] * np.column_stack([np.cos(x[:, 2]), np.sin(x[:, 2])])
        return list(effect.scan(suspicious_discs(x[:, :2] + ahead, at.ratio)))
    out = []
    for i, parameter in enumerate(effect.parameters):
        if parameter.role is not Role.SIZE:
            continue
        tried = parameter.scan or [nulls[i] + step * parameter.scale for step in _LADDER]
        out += [
            (*nulls[:i], value, *nulls[i + 1 :])
            for value in tried
            if parameter.low <= value <= parameter.high
        ]
    return out


def _linear(
    library: Library, start: Point, effect: Effect, space: Space, keep: NDArray[np.int64]
) -> list[tuple[float, ...]]:
    """The values of Newton's step from the null, its derivatives by finite differences."""
    if effect.zero_gradient:
        return []
    likelihood, z, columns = library.likelihood, carry(space, start), []
    own = range(len(keep), len(z))
    for i, parameter in zip(own, effect.parameters, strict=True):
        step = (
            0.1 * parameter.scale * (1.0 if z[i] + 0.1 * parameter.scale <= space.high[i] else -1)
        )
        moved = z.copy()
        moved[i] += step
        error, finite = likelihood.predictor.errors(space.chart.parameters(moved), start.x)
        if not finite:
            return []
        columns.append((start.linear.error - error) / step)
    by_own = likelihood.rotation @ np.stack(columns, axis=2)
    by_z = np.concatenate([start.rotated.by_z[:, :, keep], by_own], axis=2)
    rotated = start.rotated._replace(by_z=by_z)
    view = likelihood.weigh(rotated, start.size)
    at = likelihood.reduce(view, start.linear.error, start.x)
    dz, _ = newton(space, at, z)
    return [tuple((z + dz)[own.start :].tolist())]


def judge(library: Library, point: Point, temper: float, lowest: Point) -> Hypothesis:
    """An optimum's evidence with its prior odds, and the probability that its effects matter.

    The windows that favour it most and least, beside the hypothesis of lowest cost, are left out: a
    car that nearly spins multiplies any small change, and one such second shall not name a cause.
    """
    effects = point.space.effects
    posterior = posterior_of(point, temper)
    deficit = point.at.loss - lowest.at.loss
    extreme = float(max(deficit.max(), 0.0) + min(deficit.min(), 0.0)) / temper
    posterior = replace(posterior, evidence=posterior.evidence + extreme)
    odds = posterior.evidence - len(effects) * np.log(max(len(library.effects), 1))
    odds -= max(len(effects) - 1, 0) * np.log(c.FURTHER_ODDS)
    for name in effects:
        effect = library.effect(name)
        far, sd = size_of(library, posterior, effect)
        odds += log_share_beyond(far, sd, 0.0, effect.least_size)
    return Hypothesis(effects, posterior, float(odds))


def size_of(library: Library, posterior: Posterior, effect: Effect) -> tuple[float, float]:
    """How far an effect is from what the base has of it, and the standard error of that."""
    point, augmented = posterior.point, library.likelihood.predictor.augmented
    places = [i for i, p in enumerate(effect.parameters) if p.role is Role.SIZE]
    first = point.space.chart.free.index(f"{effect.name}.{effect.parameters[0].name}")
    own = augmented.values(effect.name)
    away = np.array([point.z[first + i] - own[i] for i in places])
    far = float(np.linalg.norm(away))
    along = away / far if far > 0.0 else np.eye(len(away))[0]
    mine = [first + i for i in places]
    return far, float(np.sqrt(along @ posterior.covariance[np.ix_(mine, mine)] @ along))
