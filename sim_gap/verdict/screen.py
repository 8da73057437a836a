"""Which effects are worth a refit: one Jacobian for those with a gradient, else a scan."""

# Why: docs/decisions/diagnosis.md#d88

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect
from steerd.car_model.native.windows import SENSITIVITIES
from steerd.sysid.estimation.bounded_step import step_within
from steerd.sysid.estimation.objective import STATES
from steerd.sysid.inference.engine import Engine, Reduced
from steerd.sysid.inference.levenberg_marquardt import (
    Fitted,
    curvature,
    is_curved,
    total,
)
from steerd.sysid.inference.places import suspicious_discs
from steerd.sysid.inference.space import Space, make_space

Array = NDArray[np.float64]

STRAYED = 10.0
"""What the base's move costs by its own prior before effects are looked at without it [nats]."""


class Promise(NamedTuple):
    """How much an effect could gain, from a linear look, and where to start its refit.

    Attributes:
        effect: its name.
        gain: expected fall of the cost [nats].
        start: values of its parameters to start from.
        tested: whether the simulation with it stayed finite.
        returned: whether the base is to start where its prior lies.
    """

    effect: str
    gain: float
    start: tuple[float, ...]
    tested: bool = True
    returned: bool = False


def open_effects(engine: Engine, taken: Sequence[str]) -> list[Effect]:
    """Effects that are not part of the hypothesis yet."""
    return [e for e in engine.superset.effects if e.name not in taken]


def screen(
    engine: Engine,
    fitted: Fitted,
    nuisance: Sequence[str],
    only: Sequence[str] | None = None,
) -> list[Promise]:
    """Promises of every further effect, best first.

    A base that has moved far from what is known of it stands in for what moved it. Where it stands
    that effect changes little, so effects are looked at once more with the base back at its prior.

    Args:
        engine: the windows.
        fitted: the hypothesis to add to.
        nuisance: base parameters that are free.
        only: names to look at; None looks at all.
    """
    found = {p.effect: p for p in _screen_at(engine, fitted, nuisance, only)}
    back = return_base(engine, fitted)
    if back is not None:
        dearer = back.cost - fitted.cost
        for p in _screen_at(engine, back, nuisance, only):
            if p.gain - dearer > found[p.effect].gain:
                found[p.effect] = p._replace(gain=p.gain - dearer, returned=True)
    return sorted(found.values(), key=lambda promise: -promise.gain)


def return_base(engine: Engine, fitted: Fitted) -> Fitted | None:
    """The hypothesis with its base where the prior lies; None where it stayed near that."""
    space = fitted.space
    if space.base_cost(fitted.z) < STRAYED:
        return None
    z, own = fitted.z.copy(), slice(0, fitted.space.nuisance)
    z[own] = space.centre[own]
    linear = engine.linear(space, z, fitted.x)
    if not linear.finite:
        return None
    # The starts stay: with what moved the base in its place they are as good as before.
    tangent = engine.tangent(linear)
    at = engine.reduce_by(tangent, linear.error, fitted.x)._replace(limit=fitted.at.limit)
    if not is_curved(space, at):
        return None
    return replace(fitted, z=z, at=at, cost=total(space, at, z), tangent=tangent, linear=linear)


def _screen_at(
    engine: Engine, fitted: Fitted, nuisance: Sequence[str], only: Sequence[str] | None
) -> list[Promise]:
    found: list[Promise] = []
    effects = [
        e for e in open_effects(engine, fitted.space.effects) if only is None or e.name in only
    ]
    smooth = [e for e in effects if not e.zero_gradient]
    room = SENSITIVITIES - STATES - len(fitted.z)
    while smooth:
        part: list[Effect] = []
        while smooth and sum(len(e.parameters) for e in (*part, smooth[0])) <= room:
            part.append(smooth.pop(0))
        found += _linear(engine, fitted, nuisance, part)
    return found + [_scan(engine, fitted, nuisance, e) for e in effects if e.zero_gradient]


def extended(
    engine: Engine, fitted: Fitted, nuisance: Sequence[str], effects: Sequence[str]
) -> tuple[Space, Array]:
    """The hypothesis' space with further effects, and its point there: the new ones at null."""
    space = make_space(engine.superset, nuisance, [*fitted.space.effects, *effects])
    known = dict(zip(fitted.space.chart.free, fitted.z.tolist(), strict=True))
    z = np.array([known.get(n, c) for n, c in zip(space.chart.free, space.centre, strict=True)])
    return space, z


def _expected(space: Space, at: Reduced, z: Array) -> tuple[float, Array]:
    """Fall of the cost by Newton's step, and the step."""
    h, slope = curvature(space, at), at.weight @ at.g + space.prior_pull(z)
    dz = step_within(h, slope, z, space.low, space.high)
    return float(slope @ dz - 0.5 * dz @ h @ dz), dz


def _narrowed(at: Reduced, chosen: NDArray[np.int64]) -> Reduced:
    """The same losses as functions of some of the coordinates."""
    return at._replace(
        g=at.g[:, chosen], h=at.h[:, chosen[:, None], chosen], kx=at.kx[:, :, chosen]
    )


def _linear(
    engine: Engine, fitted: Fitted, nuisance: Sequence[str], effects: Sequence[Effect]
) -> list[Promise]:
    """Promises of effects with a gradient, from one Jacobian of all of them.

    Where that is not finite, or so large that its differences are lost, each half is looked at
    alone: one effect that leaves the map must not take the others with it.
    """
    space, z = extended(engine, fitted, nuisance, [e.name for e in effects])
    at = engine.reduce(space, z, fitted.x)._replace(limit=fitted.at.limit)
    if not at.finite or not is_curved(space, at):
        if len(effects) == 1:
            return [Promise(effects[0].name, -np.inf, effects[0].nulls, tested=False)]
        half = len(effects) // 2
        first = _linear(engine, fitted, nuisance, effects[:half])
        return first + _linear(engine, fitted, nuisance, effects[half:])
    places = {name: i for i, name in enumerate(space.chart.free)}

    def look(names: Sequence[str]) -> tuple[float, Array, Array, Space]:
        own, start = extended(engine, fitted, nuisance, names)
        chosen = np.array([places[name] for name in own.chart.free], dtype=np.int64)
        gain, dz = _expected(own, _narrowed(at, chosen), start)
        return gain, start, dz, own

    floor = look(())[0]
    found = []
    for effect in effects:
        gain, start, dz, own = look([effect.name])
        mine = slice(len(start) - len(effect.parameters), None)
        value = np.clip((start + dz)[mine], own.low[mine], own.high[mine])
        found.append(Promise(effect.name, gain - floor, tuple(value.tolist())))
    return found


def _scan(engine: Engine, fitted: Fitted, nuisance: Sequence[str], effect: Effect) -> Promise:
    """The best of an effect's scan values, with everything else stepped once."""
    space, z = extended(engine, fitted, nuisance, [effect.name])
    best = Promise(effect.name, 0.0, tuple(z[len(fitted.z) :].tolist()))
    for start in scan_values(engine, fitted, effect):
        z[len(fitted.z) :] = start
        error, finite = engine.missed(space, z, fitted.x)
        if not finite:
            continue
        at = engine.reduce_by(fitted.tangent, error, fitted.x)._replace(limit=fitted.at.limit)
        if not is_curved(fitted.space, at):
            continue
        cost = total(fitted.space, at, fitted.z)
        gain = fitted.cost - cost + _expected(fitted.space, at, fitted.z)[0]
        if gain > best.gain:
            best = Promise(effect.name, gain, start)
    return best


def scan_values(engine: Engine, fitted: Fitted, effect: Effect) -> list[tuple[float, ...]]:
    """Values worth trying: by the effect's own scan, else by its parameters' lists."""
    if effect.scan is not None:
        badness = fitted.at.square / fitted.at.dof
        return list(effect.scan(suspicious_discs(_middles(fitted), badness)))
    nulls = list(engine.superset.nulls[effect.name])
    values = []
    for i, parameter in enumerate(effect.parameters):
        for value in parameter.scan:
            tried = nulls.copy()
            tried[i] = value
            values.append(tuple(tried))
    return values


def _middles(fitted: Fitted) -> Array:
    """(W, 2) where each window's car is half a second after its start [m]."""
    x = fitted.x
    ahead = 0.5 * x[:, 3:4] * np.column_stack([np.cos(x[:, 2]), np.sin(x[:, 2])])
    return np.asarray(x[:, :2] + ahead)
