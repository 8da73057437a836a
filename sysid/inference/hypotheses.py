"""Which effects: every hypothesis from the base at its prior, under a discrepancy like the gap.

A hypothesis is a set of effects beside the base. Each is looked at from where nothing has moved
yet, under the discrepancy that the base at its prior needs; the likeliest are brought to their
optimum. No hypothesis may be worse than one nested in it: bases are exchanged until none is.
"""

# Why: docs/decisions/diagnosis.md#d117
# Why: docs/decisions/diagnosis.md#d118

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import softmax

from steerd.car_model.effect import Effect, Role
from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.library import Library, carry, linearise
from steerd.sysid.inference.likelihood import Weighed, loss_of
from steerd.sysid.inference.odds import Hypothesis, Shown, price, rank, shown_most
from steerd.sysid.inference.places import suspicious_discs
from steerd.sysid.inference.residuals import excess_of
from steerd.sysid.inference.search import BEHIND, Point, minimise, newton, open_point, stand
from steerd.sysid.inference.space import Space

_FITTED, _FITTED_FURTHER = 6, 3
"""Hypotheses with a first effect that are brought to their optimum, and with a further one."""
_LADDER = (-1.5, -0.5, 0.5, 1.5)
"""Values that are tried, in prior scales of the parameter off what the base has."""
_LOOKS = (1.0, 0.3, 0.1)  # shares of the starting size at which a look compares hypotheses
_ANYHOW = 2  # the most promising are optimised even where the first is clearly better
_WORSE = 0.5  # nats by which a hypothesis counts as worse than another ...
_HOPELESS = 1000.0  # ... and by which nothing that another's base adds makes up for


@dataclass(frozen=True, eq=False)
class Findings:
    """All hypotheses that were brought to an optimum, the likeliest first."""

    hypotheses: tuple[Hypothesis, ...]  # see there
    start: Point  # the base at its prior, under the discrepancy that it needs
    untested: tuple[str, ...]  # effects whose simulation does not stay finite
    excess: tuple[float, float]  # see `excess_of`: at the start and at the best

    @property
    def best(self) -> Hypothesis:
        """The likeliest; with a name where a gap is likelier than none, whatever shares it."""
        return next(h for h in self.hypotheses if h.effects or self.null.probability >= c.HALF)

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
    shown: Shown = field(default_factory=dict)
    grown: set[frozenset[str]] = field(default_factory=lambda: {frozenset()})
    exchanged: set[tuple[tuple[str, ...], tuple[str, ...], int]] = field(default_factory=set)

    def hypotheses(self) -> list[Hypothesis]:
        """All of them with their odds, the likeliest first."""
        return rank(self.library, list(self.pool.values()), self.shown)

    def keep(self, point: Point | None) -> None:
        """Keep an optimum if it is the best of its hypothesis so far."""
        if point is None:
            return
        key = frozenset(point.space.effects)
        if key not in self.pool or point.cost < self.pool[key].cost:
            self.pool[key] = point

    def grow(self, start: Point, most: int) -> None:
        """A hypothesis, its base begun at the prior; the `most` likeliest with an effect more."""
        if start.space.effects or not self.pool:  # the base's own optimum may be known
            self.keep(self._optimum(lambda: start))
        looks = screen_effects(self.library, start, far=leaves_gap(start))
        self.untested |= {look.effect for look in looks if not np.isfinite(look.cost)}
        count = len(start.space.effects)
        needed = price(self.library, count + 1) - price(self.library, count)
        # `needed`: what a name must gain before its odds are even, not tempered [nats]
        least = needed * self.library.design_effect(0.3 * start.size)
        self._fit(start, [look for look in looks if look.gain > least][:most])
        self.exchange()
        self._look_again(start, needed, most)

    def grow_further(self, names: tuple[str, ...], point: Point) -> None:
        """`grow` from effects as a point has them, once for each set of them."""
        if frozenset(names) not in self.grown:
            self.grown.add(frozenset(names))
            self.grow(_again(self.library, names, point), _FITTED_FURTHER)

    def _fit(self, start: Point, chosen: Sequence["Candidate"]) -> None:
        """A hypothesis with one effect more, from the values of each look, the likeliest first.

        Where one leaves no gap, none that expects to stay clearly behind it is searched.
        """
        for number, look in enumerate(chosen):
            top = min([start, *self.pool.values()], key=lambda point: point.cost)
            behind = number >= _ANYHOW and look.cost > top.cost + BEHIND
            if not behind or leaves_gap(top):
                self.keep(self._optimum(partial(_with_effect, self.library, start, look), top.cost))

    def _look_again(self, start: Point, needed: float, most: int) -> None:
        """The same from the hypothesis' optimum, for what promises more there than was found.

        A small effect does not show under a large discrepancy that the base at its prior needs.
        """
        before = self.pool.get(frozenset(start.space.effects))
        if before is None or before.size >= start.size or not leaves_gap(start):
            return
        least = needed * self.library.design_effect(before.size)
        chosen, lowest = [], min(point.cost for point in self.pool.values())
        for look in screen_effects(self.library, before, far=False):
            known = self.pool.get(frozenset([*start.space.effects, look.effect]))
            better = known is None or look.cost < known.cost - _WORSE
            if better and look.gain > least and look.cost < lowest + BEHIND:
                chosen.append(look)
        self._fit(before, chosen[:most])
        self.exchange()

    def exchange(self) -> None:
        """Bases exchanged until no hypothesis is worse than one nested in it.

        What is nested in the best is tried from the best's base as well: what the base alone gains
        there is no effect's.
        """
        for _ in range(3):
            best = min(self.pool.values(), key=lambda point: point.cost)
            whole = frozenset(best.space.effects)
            near = best.cost + _HOPELESS
            inner = [p for names, p in self.pool.items() if names < whole and p.cost < near]
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
        moved = partial(carry, self.library.likelihood, space, other)
        found = self._from(space, moved(point), other, wider)
        lowest = min(point.cost, np.inf if found is None else found.cost)
        if set(other.space.effects) < set(space.effects) and lowest > other.cost + _WORSE:
            again = self._from(space, moved(), other, other.size)
            found = min((p for p in (found, again) if p), key=lambda p: p.cost, default=None)
        if found is None or found.cost > point.cost - _WORSE:
            return False
        self.keep(found)
        return True

    def _from(self, space: Space, z: Array, other: Point, size: float) -> Point | None:
        """The optimum from coordinates at another hypothesis' starts."""
        return self._optimum(partial(stand, self.library.likelihood, space, z, other.x, size))

    def _optimum(self, begin: Callable[[], Point], incumbent: float = np.inf) -> Point | None:
        """The optimum from a start; None if the simulation diverges there or on the way."""
        try:
            return minimise(self.library.likelihood, begin(), incumbent)
        except (FloatingPointError, np.linalg.LinAlgError):
            return None


def explain(
    library: Library,
    most: int = 2,
    progress: Callable[[float], None] = lambda share: None,
    known: Point | None = None,
) -> Findings:
    """The hypotheses of a case.

    Args:
        library: what may be a hypothesis.
        most: causes at most.
        progress: called with the share done.
        known: an optimum of the base alone, if one was found before.

    Raises:
        FloatingPointError: the base car's simulation diverges.
    """
    search = _Search(library)
    search.keep(known)
    start = begin(library, (), (), library.likelihood.predictor.guess.copy())
    search.grow(start, _FITTED)
    best = search.hypotheses()[0]
    if not best.effects and leaves_gap(best.point):  # no one effect may be enough
        best = min(search.hypotheses(), key=lambda h: h.point.cost)
    while 0 < len(best.effects) < most:
        progress(0.5)
        search.grow_further(best.effects, best.point)
        likeliest = search.hypotheses()[0]
        if likeliest.effects == best.effects:
            break
        best = likeliest
        for name in best.effects:
            search.grow_further(tuple(n for n in best.effects if n != name), best.point)
        best = search.hypotheses()[0]
    found = search.hypotheses()
    share = softmax([h.log_odds for h in found])
    ranked = [replace(h, probability=float(p)) for h, p in zip(found, share, strict=True)]
    before, after = (excess_of(library.likelihood, p) for p in (start, ranked[0].point))
    return Findings(tuple(ranked), start, tuple(sorted(search.untested)), (before, after))


def is_lost(point: Point) -> bool:
    """Whether most windows leave more than counts: the smallest discrepancy then costs least."""
    return bool(point.at.spun.mean() > c.HALF)


def leaves_gap(point: Point) -> bool:
    """Whether an optimum leaves more than noise."""
    return point.size > c.GAP_SIZE or is_lost(point)


def begin(library: Library, names: Sequence[str], values: Sequence[float], x: Array) -> Point:
    """The base at its prior with some effects' values, under the discrepancy that this needs.

    Raises:
        FloatingPointError: the simulation diverges there.
    """
    space, likelihood = library.space(names), library.likelihood
    z = space.centre.copy()
    z[len(z) - len(values) :] = values
    return open_point(likelihood, space, z, x)


def _again(library: Library, names: Sequence[str], point: Point) -> Point:
    """A hypothesis with its base back at the prior; its effects' values and starts stay."""
    known = dict(zip(point.space.chart.free, point.z.tolist(), strict=True))
    own = [n for n in library.space(names).chart.free if n.partition(".")[0] in names]
    try:
        return begin(library, names, [known[n] for n in own], point.x)
    except FloatingPointError:
        return point


@dataclass(frozen=True)
class Candidate:
    """What an effect promises from the base at its prior."""

    effect: str  # its name; `values` of its parameters to start from
    values: tuple[float, ...]
    cost: float = np.inf  # expected beside the base one step on [nats]
    gain: float = -np.inf  # below the start's cost, and that with it as in healthy drives [nats]


def screen_effects(library: Library, start: Point, far: bool = True) -> list[Candidate]:
    """Every effect that the start lacks, the most promising first.

    Newton's step from the start is tried; `far` also tries values that no slope leads to.

    No window's start is held here: one that the base alone bends too far may be where an effect
    shows, and could then not follow it.
    """
    held = np.zeros_like(start.rotated.held)
    start = replace(start, rotated=start.rotated._replace(held=held))
    views = [library.likelihood.weigh(start.rotated, share * start.size) for share in _LOOKS]
    prior = _prior(library, start.space, start.z)
    level = _expected(library, start, views, prior, start.linear.error)
    found, temper = [], library.design_effect(start.size)
    for effect in (e for e in library.effects if e.name not in start.space.effects):
        known = library.controls.get(effect.name)
        healthy = [] if known is None else [tuple(known.values.tolist())]
        tried = _linear(library, start, effect)
        tried += _ladder(library, start, effect) if far or not tried else []
        looks = list(_looks(library, start, views, effect, [*tried, *healthy]))
        looks, others = looks[: len(tried)], looks[len(tried) :]
        # Without its parameter of the same name a base may move further: that gains no more.
        most = 0.0 if known is None else shown_most(library, known) * temper
        reference = max(min([level, *(look.cost for look in others)]), level - most)
        best = min(looks, key=lambda look: look.cost, default=Candidate(effect.name, effect.nulls))
        found.append(replace(best, gain=reference - best.cost))
    return sorted(found, key=lambda look: -look.gain)


def _with_effect(library: Library, start: Point, look: Candidate) -> Point:
    """The start with an effect at the values of its look."""
    space = library.space([*start.space.effects, look.effect])
    z = carry(library.likelihood, space, start)
    z[-len(look.values) :] = look.values
    z = np.clip(z, space.low, space.high)
    return stand(library.likelihood, space, z, start.x, start.size)


def _looks(
    library: Library,
    start: Point,
    views: Sequence[Weighed],
    effect: Effect,
    tried: Iterable[tuple[float, ...]],
) -> Iterable[Candidate]:
    """An effect at several values, the base stepped once beside each."""
    space, likelihood = library.space([*start.space.effects, effect.name]), library.likelihood
    own = slice(len(space.centre) - len(effect.parameters), None)
    names = space.chart.free[: own.start]
    keep = np.array([start.space.chart.free.index(name) for name in names], int)
    if len(keep) < len(start.z):
        views = [view.take(keep) for view in views]
    base = carry(likelihood, space, start)[: own.start]
    prior = _prior(library, space, base)
    for values in tried:
        z = np.clip(np.concatenate([base, values]), space.low, space.high)
        error, finite = likelihood.predictor.errors(space.chart.parameters(z), start.x)
        cost = _expected(library, start, views, prior, error) if finite else np.inf
        yield Candidate(effect.name, tuple(z[own].tolist()), cost)


_Prior = tuple[Array, Array]


def _prior(library: Library, space: Space, base: Array) -> _Prior:
    """How far the base's coordinates (n,) are from their centre, and the precision of that."""
    n, worth = len(base), library.worth
    precision = np.linalg.inv(space.covariance[:n, :n] / worth)
    return base - space.centre[:n], np.asarray(precision, np.float64)


def _expected(
    library: Library, start: Point, views: Sequence[Weighed], prior: _Prior, error: Array
) -> float:
    """Cost at the best of a few sizes after one step of the base, with the start's derivatives."""
    row, best, (away, precision) = library.likelihood.rotate_error(error), np.inf, prior
    for view in views:
        at = library.likelihood.reduce_row(view, row, start.x)
        pulled = at.weight @ at.g - precision @ away
        dz = np.linalg.solve(np.tensordot(at.weight, at.h, 1) + precision, pulled)
        square = at.square - 2.0 * at.g @ dz + ((at.h @ dz) * dz).sum(axis=1)
        loss, far = loss_of(square, at.dof) + at.volume, away + dz
        best = min(best, float(loss.sum()) + 0.5 * float(far @ precision @ far))
    return best


def _ladder(library: Library, start: Point, effect: Effect) -> list[tuple[float, ...]]:
    """Values worth trying about what the base has of the effect."""
    nulls = library.likelihood.predictor.augmented.values(effect.name)
    if effect.scan is not None:
        x, at = start.x, start.at
        ahead = 0.5 * x[:, 3:4] * np.column_stack([np.cos(x[:, 2]), np.sin(x[:, 2])])
        return list(effect.scan(suspicious_discs(x[:, :2] + ahead, at.ratio)))
    out = []
    for i, parameter in enumerate(effect.parameters):
        if parameter.role is not Role.SIZE:
            continue
        tried = parameter.scan or [nulls[i] + step * parameter.scale for step in _LADDER]
        inside = (value for value in tried if parameter.low <= value <= parameter.high)
        out += [(*nulls[:i], value, *nulls[i + 1 :]) for value in inside]
    return out


def _linear(library: Library, start: Point, effect: Effect) -> list[tuple[float, ...]]:
    """The values of Newton's step from the null."""
    found = linearise(library, start, effect)
    if found is None:
        return []
    space, z, at = found
    dz, _ = newton(space, at, z)
    return [tuple((z + dz)[-len(effect.parameters) :].tolist())]
