"""Which effects: every hypothesis from the base at its prior, under a discrepancy as large as the gap.

A hypothesis is a set of effects beside the base. Each starts where nothing has moved yet, at the
size of discrepancy that the base at its prior needs; the likeliest are brought to their optimum.
No hypothesis may be worse than one nested in it: bases are exchanged until none is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect
from steerd.sim_gap.verdict.places import suspicious_discs
from steerd.sysid.compiler.codegen import SENSITIVITIES
from steerd.sysid.estimation.objective import STATES
from steerd.sysid.inference.likelihood import Likelihood, Reduced
from steerd.sysid.inference.posterior import (
    Posterior,
    design_effect,
    log_share_beyond,
    posterior_of,
)
from steerd.sysid.inference.search import (
    Point,
    derive,
    fresh,
    minimise,
    newton,
    settle,
    stand,
)
from steerd.sysid.inference.space import Space, make_space

Array = NDArray[np.float64]

FITTED = 6
"""Hypotheses of a round that are brought to their optimum."""
LADDER = (-1.5, -0.5, 0.5, 1.5)
"""Values that are tried, in prior scales of the parameter off its null."""
FURTHER = 10.0
"""Odds against each further cause, beside its share of the library."""
LOOKS = (1.0, 0.3, 0.1)
"""Shares of the starting size at which a look compares hypotheses."""
SAME = {
    "steer_delay": ("steer_delay",), "mocap_latency": ("pose_delay",),
    "drive_delay": ("drive_delay",), "steer_bias": ("steer_bias",), "steer_gain": ("steer_gain",),
    "steer_lag": ("steer_lag",), "speed_scale": ("speed_gain",), "drive_lag": ("speed_lag",),
    "accel_limit": ("accel_max", "decel_max"), "steer_rate_limit": ("steer_rate",),
    "yaw_inertia": ("inertia_z",), "mass": ("inertia_z",),
}  # fmt: skip
"""Base parameters that are the same physical quantity as an effect: nothing is free twice."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects beside the base, at their optimum.

    Attributes:
        effects: their names, in the order in which they were found.
        posterior: the optimum, its evidence and covariance.
        log_odds: of the hypothesis, not normalised [nats].
    """

    effects: tuple[str, ...]
    posterior: Posterior
    log_odds: float

    @property
    def point(self) -> Point:
        """The optimum."""
        return self.posterior.point


@dataclass(frozen=True, eq=False)
class Findings:
    """All hypotheses that were brought to an optimum, the likeliest first.

    Attributes:
        hypotheses: with their probabilities (sum 1) in `probability`.
        start: the base at its prior, under the size that it needs.
        temper: the case's design effect.
        untested: effects whose simulation does not stay finite.
    """

    hypotheses: tuple[Hypothesis, ...]
    probability: Array
    start: Point
    null: Hypothesis
    temper: float
    untested: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Library:
    """What may be a hypothesis: the windows, the base's free parameters, the effects."""

    likelihood: Likelihood
    nuisance: tuple[str, ...]
    effects: tuple[Effect, ...]

    def space(self, names: Sequence[str]) -> Space:
        """Coordinates of a hypothesis."""
        gone = {twin for name in names for twin in SAME.get(name, ())}
        free = [name for name in self.nuisance if name not in gone]
        return make_space(self.likelihood.engine.superset, free, names)

    def effect(self, name: str) -> Effect:
        """An effect by name."""
        return next(e for e in self.likelihood.engine.superset.effects if e.name == name)


def carry(space: Space, point: Point) -> Array:
    """A point's values in another hypothesis' coordinates; what it lacks is at its prior."""
    known = dict(zip(point.space.chart.free, point.z.tolist(), strict=True))
    z = np.array([known.get(n, c) for n, c in zip(space.chart.free, space.centre, strict=True)])
    return np.clip(z, space.low, space.high)


def begin(library: Library, names: Sequence[str], values: Sequence[float], x: Array) -> Point:
    """The base at its prior with some effects' values, at the size that this needs.

    Raises:
        FloatingPointError: the simulation diverges there.
    """
    space, likelihood = library.space(names), library.likelihood
    z = space.centre.copy()
    if len(values):
        z[-len(values) :] = values
    size = 1.0
    point = stand(likelihood, space, np.clip(z, space.low, space.high), x, size)
    for _ in range(3):
        size = likelihood.best_size(point.rotated, point.linear.error, point.x)
        at = likelihood.reduce(point.rotated, point.linear.error, point.x, size)
        point = settle(likelihood, replace(point, size=size, at=at, cost=np.inf), 2)
    return fresh(likelihood, point)


@dataclass(frozen=True)
class Look:
    """What an effect promises from the base at its prior.

    Attributes:
        effect: its name; `values` of its parameters to start from.
        cost: expected at the best size [nats].
    """

    effect: str
    values: tuple[float, ...]
    cost: float


def look_at_all(library: Library, start: Point) -> list[Look]:
    """Every effect that is not part of the start yet, the most promising first."""
    taken = set(start.space.effects)
    left = [e for e in library.effects if e.name not in taken]
    found = []
    for effect in left:
        options = [look for look in _values(library, start, effect)]
        best = min(options, key=lambda look: look.cost, default=None)
        found.append(best or Look(effect.name, effect.nulls, np.inf))
    return sorted(found, key=lambda look: look.cost)


def _values(library: Library, start: Point, effect: Effect) -> list[Look]:
    """The effect at several values, the base stepped once beside each."""
    space = library.space([*start.space.effects, effect.name])
    own = slice(len(space.centre) - len(effect.parameters), None)
    keep = _kept(start, space, effect)
    out = []
    nulls = space.centre[own].tolist()
    for values in [*_ladder(library, start, effect, nulls), *_linear(library, start, effect, space)]:
        z = carry(space, start)
        z[own] = values
        z = np.clip(z, space.low, space.high)
        error, finite = library.likelihood.engine.missed(space, z, start.x)
        if finite:
            cost = _expected(library, start, space, keep, error)
            out.append(Look(effect.name, tuple(z[own].tolist()), cost))
    return out


def _kept(start: Point, space: Space, effect: Effect) -> NDArray[np.int64]:
    """Places in the start's coordinates of those that a further effect leaves free."""
    names = space.chart.free[: len(space.centre) - len(effect.parameters)]
    return np.array([start.space.chart.free.index(name) for name in names])


def _expected(
    library: Library, start: Point, space: Space, keep: NDArray[np.int64], error: Array
) -> float:
    """Cost at the best of a few sizes after one step of the base, with the start's derivatives."""
    rotated = start.rotated._replace(by_z=start.rotated.by_z[:, :, keep])
    n = len(keep)
    best = np.inf
    for share in LOOKS:
        at = library.likelihood.reduce(rotated, error, start.x, share * start.size)
        precision = np.linalg.inv(space.covariance[:n, :n])
        h = np.einsum("w,wij->ij", at.weight, at.h) + precision
        slope = at.weight @ at.g
        dz = np.linalg.solve(h, slope)
        square = at.square - 2.0 * at.g @ dz + np.einsum("i,wij,j->w", dz, at.h, dz)
        loss = at.dof * np.log1p(np.maximum(square, 0.0) / at.dof) + at.volume
        best = min(best, float(loss.sum()) + 0.5 * float(dz @ precision @ dz))
    return best


def _ladder(
    library: Library, start: Point, effect: Effect, nulls: Sequence[float]
) -> list[tuple[float, ...]]:
    """Values worth trying about what the base has of the effect."""
    if effect.scan is not None:
        x, at = start.x, start.at
        ahead = 0.5 * x[:, 3:4] * np.column_stack([np.cos(x[:, 2]), np.sin(x[:, 2])])
        return list(effect.scan(suspicious_discs(x[:, :2] + ahead, at.square / at.dof)))
    out = []
    for i, parameter in enumerate(effect.parameters):
        if parameter.role.value != "size":
            continue
        tried = parameter.scan or [nulls[i] + step * parameter.scale for step in LADDER]
        for value in tried:
            if parameter.low <= value <= parameter.high:
                out.append((*nulls[:i], value, *nulls[i + 1 :]))
    return out


def _linear(
    library: Library, start: Point, effect: Effect, space: Space
) -> list[tuple[float, ...]]:
    """The value of Newton's step from the null at the start's size, by finite differences."""
    if effect.zero_gradient:
        return []
    point = Point(space, carry(space, start), start.x, start.size, start.linear, start.rotated,
                  start.at, start.cost)  # fmt: skip
    keep = _kept(start, space, effect)
    own = range(len(space.centre) - len(effect.parameters), len(space.centre))
    columns = []
    for i, parameter in zip(own, effect.parameters, strict=True):
        step = 0.1 * parameter.scale
        step = step if point.z[i] + step <= space.high[i] else -step
        moved = point.z.copy()
        moved[i] += step
        error, finite = library.likelihood.engine.missed(space, moved, start.x)
        if not finite:
            return []
        columns.append((start.linear.error - error) / step)
    by_own = library.likelihood.rotation @ np.stack(columns, axis=2)
    rotated = start.rotated._replace(
        by_z=np.concatenate([start.rotated.by_z[:, :, keep], by_own], axis=2)
    )
    at = library.likelihood.reduce(rotated, start.linear.error, start.x, start.size)
    dz, _ = newton(space, at, point.z)
    return [tuple((point.z + dz)[own.start :].tolist())]


def explain(
    library: Library,
    pairs: bool = True,
    progress: Callable[[float], None] = lambda share: None,
) -> Findings:
    """The hypotheses of a case."""
    start = begin(library, (), (), library.likelihood.engine.readings.layout.guess.copy())
    temper_at = start
    ranked, null, untested = _round(library, start, None)
    temper = design_effect(library.likelihood, min(r.size for r in [null, *ranked]))
    found = [_hypothesis(library, point, temper) for point in [null, *ranked]]
    best = max(found, key=lambda h: h.log_odds)
    while pairs and 0 < len(best.effects) < 3:
        progress(0.5)
        values = best.point.z[best.point.space.nuisance :]
        again = begin(library, best.effects, values.tolist(), best.point.x)
        further, alone, _ = _round(library, again, best.point)
        temper = min(temper, design_effect(library.likelihood, min(p.size for p in [alone, *further])))
        found = [_hypothesis(library, h.point, temper) for h in found if h.effects != best.effects]
        found += [_hypothesis(library, p, temper) for p in (alone, *further)]
        likeliest = max(found, key=lambda h: h.log_odds)
        if len(likeliest.effects) <= len(best.effects):
            break
        best = likeliest
        for name in best.effects[:-1]:
            rest = tuple(n for n in best.effects if n != name)
            if not any(set(h.effects) == set(rest) for h in found):
                point = from_point(library, rest, best.point)
                if point is not None:
                    found.append(_hypothesis(library, point, temper))
        best = max(found, key=lambda h: h.log_odds)
    found = sorted(found, key=lambda h: -h.log_odds)
    odds = np.array([h.log_odds for h in found])
    probability = np.exp(odds - odds.max())
    null_h = next(h for h in found if not h.effects)
    return Findings(tuple(found), probability / probability.sum(), start, null_h, temper, untested)


def from_point(library: Library, names: Sequence[str], point: Point) -> Point | None:
    """The optimum of a hypothesis from where another one lies; None if it diverges."""
    space = library.space(names)
    z = carry(space, point)
    try:
        begun = stand(library.likelihood, space, z, point.x, 2.0 * point.size + 0.02)
        return minimise(library.likelihood, begun)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None


def _round(
    library: Library, start: Point, known: Point | None
) -> tuple[list[Point], Point, tuple[str, ...]]:
    """The most promising further effects at their optima, and the hypothesis without them."""
    likelihood = library.likelihood
    null = minimise(likelihood, start)
    if known is not None and known.cost < null.cost:
        null = known
    looks = look_at_all(library, start)
    untested = tuple(look.effect for look in looks if not np.isfinite(look.cost))
    fitted: list[Point] = []
    for look in [look for look in looks if np.isfinite(look.cost)][:FITTED]:
        names = (*start.space.effects, look.effect)
        space = library.space(names)
        z = carry(space, start)
        z[-len(look.values) :] = look.values
        try:
            begun = stand(likelihood, space, np.clip(z, space.low, space.high), start.x, start.size)
            beat = min((p.cost for p in fitted), default=np.inf)
            fitted.append(minimise(likelihood, begun, beat))
        except (FloatingPointError, np.linalg.LinAlgError):
            continue
    return *_exchanged(library, null, fitted), untested


def _exchanged(library: Library, null: Point, fitted: list[Point]) -> tuple[list[Point], Point]:
    """Bases exchanged until no hypothesis is worse than the one nested in it."""
    for _ in range(2):
        best = min(fitted, key=lambda p: p.cost, default=null)
        from_best = from_point(library, null.space.effects, best)
        if from_best is not None and from_best.cost < null.cost - 0.5:
            null = from_best
        worse = [p for p in fitted if p.cost > null.cost - 0.5]
        changed = False
        for point in worse:
            again = from_point(library, point.space.effects, null)
            if again is not None and again.cost < point.cost - 0.5:
                fitted[fitted.index(point)] = again
                changed = True
        if not changed:
            break
    return fitted, null


def _hypothesis(library: Library, point: Point, temper: float) -> Hypothesis:
    """Evidence, prior odds, and the share of the posterior that is large enough to matter."""
    effects, superset = point.space.effects, library.likelihood.engine.superset
    posterior = posterior_of(point, temper)
    odds = posterior.evidence / temper - len(effects) * np.log(len(library.effects))
    odds -= max(len(effects) - 1, 0) * np.log(FURTHER)
    for name in effects:
        effect = library.effect(name)
        places = [i for i, n in enumerate(point.space.chart.free) if n.startswith(f"{name}.")]
        sizes = [i for i, p in zip(places, effect.parameters, strict=True) if p.role.value == "size"]
        nulls = np.array(superset.nulls[name])[[places.index(i) for i in sizes]]
        away = point.z[sizes] - nulls
        far = float(np.linalg.norm(away))
        along = away / far if far > 0.0 else np.eye(len(away))[0]
        sd = float(np.sqrt(along @ posterior.covariance[np.ix_(sizes, sizes)] @ along))
        odds += log_share_beyond(far, sd, 0.0, effect.least_size)
    return Hypothesis(effects, posterior, float(odds))
