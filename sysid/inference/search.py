"""From a start to the optimum of a hypothesis: Newton steps while the discrepancy's size falls.

The likelihood of a wrong start is sharp and rough. Under a discrepancy as large as the gap it is
blunt and nearly quadratic, so the search begins there and lets the size fall a little with every
step until it reaches the size that the errors themselves ask for (graduated optimisation).
"""

# Why: docs/decisions/diagnosis.md#d66
# Why: docs/decisions/diagnosis.md#d91

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference.likelihood import Likelihood, Reduced, Rotated, Weighed, take_some
from steerd.sysid.inference.predictor import Linear
from steerd.sysid.inference.space import Space
from steerd.sysid.inference.starts import owes, settle_starts

FALL = 2.2  # the size falls by this factor a step at most: faster, dead times are left behind
ENOUGH = 0.3  # a step that promises and gains less at the last size ends the search [nats]
STEPS = 24
_LIMITS = {"accel_max": 0.3, "decel_max": 0.3, "steer_rate": 0.05}
"""Steps over which limits are differenced: [m/s^2], and relative for the slew rate."""
_TRUST = 0.4  # derivatives are taken anew where a step's promise is off by this share ...
_FAR = 30.0  # ... or after so many nats
_DAMPING_MAX = 1e4
BEHIND = 80.0  # a search that is so many nats behind another hypothesis is given up
_ROUNDS = 2  # steps of every window's start after one of the coordinates
_SHORTER = 0.25  # a start's step that led up is tried again so much shorter
_UNTIL = 4  # steps before a search may be given up
_EXCHANGES = 200  # of coordinates at and off their bounds, at most
_HAIR, _APART = 1e-12, 1e-10
"""Bounds must lie apart, and no two coordinates do the same to the last digit: by so much."""


@dataclass(frozen=True, eq=False)
class Point:
    """A hypothesis somewhere."""

    space: Space  # its coordinates
    z: Array  # (n,) their values; x: (W, 7) the windows' starts
    x: Array
    size: float  # of the discrepancy
    linear: Linear  # errors here and derivatives here or near; `rotated` the derivatives, rotated
    rotated: Rotated
    weighed: Weighed  # the same under the size
    at: Reduced  # losses here
    cost: float  # losses and prior [nats]
    whole: bool = True  # whether the search came to its end, not to its limit of steps

    @property
    def parameters(self) -> Array:
        """(P,) all parameters of the augmented car."""
        return self.space.chart.parameters(self.z)


def derive(likelihood: Likelihood, space: Space, z: Array, x: Array) -> Linear:
    """Errors and derivatives, those of limits as secants.

    A limit acts only where something meets it. The likelihood has kinks there, and a slope between
    two of them leads nowhere.
    """
    predictor = likelihood.predictor
    linear = predictor.linear(space, z, x)
    for i, name in enumerate(space.chart.free):
        step = _LIMITS.get(name, 0.0)
        end = z[i] + step if z[i] + step <= space.high[i] else z[i] - step
        if step == 0.0 or not space.low[i] <= end:
            continue
        moved = z.copy()
        moved[i] = end
        error, _ = predictor.errors(space.chart.parameters(moved), x)
        linear.by_z[:, :, i] = (linear.error - error) / (end - z[i])
    return linear


def stand(
    likelihood: Likelihood, space: Space, z: Array, x: Array, size: float, near: bool = False
) -> Point:
    """A hypothesis at given coordinates, its starts at their best.

    Where these are `near`, derivatives are taken at once, and again for windows whose start moves.

    Raises:
        FloatingPointError: the simulation diverges there.
    """
    parameters = space.chart.parameters(z)
    linear = derive(likelihood, space, z, x) if near else None
    by = (linear.error, linear.by_x) if linear else likelihood.predictor.by_starts(parameters, x)
    settled, owed = settle_starts(likelihood, parameters, x, by, size)
    moved = (settled != x).any(axis=1)
    if linear is None:
        linear = derive(likelihood, space, z, settled)
    elif moved.any():
        again = derive(take_some(likelihood, moved), space, z, settled[moved])
        for old, new in zip(linear[:3], again[:3], strict=True):
            old[moved, : new.shape[1]] = new
    if not linear.finite:
        raise FloatingPointError("the simulation diverges")
    rotated = likelihood.rotate(linear)._replace(held=owed)
    weighed = likelihood.weigh(rotated, size)
    at = likelihood.reduce(weighed, linear.error, settled)
    return Point(space, z, settled, size, linear, rotated, weighed, at, _cost(space, at, z))


def open_point(likelihood: Likelihood, space: Space, z: Array, x: Array) -> Point:
    """A hypothesis at given coordinates, its starts settled under the discrepancy that it needs.

    Raises:
        FloatingPointError: the simulation diverges there.
    """
    point = stand(likelihood, space, np.clip(z, space.low, space.high), x, 1.0)
    for _ in range(3):
        size = likelihood.best_size(point.rotated, point.linear.error, point.x)
        point = with_size(likelihood, point, size)
    return fresh(likelihood, point)


def _followed(likelihood: Likelihood, point: Point) -> Point:
    """The windows' starts stepped with the point's derivatives, each where that is better."""
    x, error, at = point.x.copy(), point.linear.error.copy(), point.at
    row, share = likelihood.rotate_error(error), np.ones(len(x))
    for _ in range(_ROUNDS):
        if not owes(at.here, at.here - at.square, at.dof).any():
            break
        tried = x + share[:, None] * at.dx
        off, _ = likelihood.predictor.errors(point.parameters, tried)
        turned = likelihood.rotate_error(off)
        better = likelihood.squares(turned, tried, point.size) < at.here
        x[better], error[better], row[better] = tried[better], off[better], turned[better]
        share = np.where(better, 1.0, _SHORTER * share)
        at = likelihood.reduce_row(point.weighed, row, x)
    linear = point.linear._replace(error=error)
    return replace(point, x=x, linear=linear, at=at, cost=_cost(point.space, at, point.z))


def _cost(space: Space, at: Reduced, z: Array) -> float:
    return float(at.loss.sum()) + space.prior_cost(z)


def curvature(space: Space, at: Reduced) -> Array:
    """(n, n) Gauss-Newton curvature of the cost."""
    return np.asarray(np.tensordot(at.weight, at.h, 1) + space.precision)


def with_size(likelihood: Likelihood, point: Point, size: float) -> Point:
    """The same point under another size."""
    if size == point.size:
        return point
    weighed = likelihood.weigh(point.rotated, size)
    at = likelihood.reduce(weighed, point.linear.error, point.x)
    changed = replace(
        point, size=size, weighed=weighed, at=at, cost=_cost(point.space, at, point.z)
    )
    return _followed(likelihood, changed)


def fresh(likelihood: Likelihood, point: Point) -> Point:
    """The same point with derivatives taken there."""
    return stand(likelihood, point.space, point.z, point.x, point.size, near=True)


def _moved(likelihood: Likelihood, point: Point, dz: Array) -> Point | None:
    """The point a step on, with the derivatives of before; None where too much diverges.

    Starts go with the coordinates; their own steps follow, each where it is better: all of them
    taken at once, a step of nothing could lead up.
    """
    x = point.x - point.at.kx @ dz
    z = np.clip(point.z + dz, point.space.low, point.space.high)
    error, finite = likelihood.predictor.errors(point.space.chart.parameters(z), x)
    if not finite:
        return None
    at = likelihood.reduce(point.weighed, error, x)
    moved = replace(
        point, z=z, x=x, at=at, cost=_cost(point.space, at, z),
        linear=point.linear._replace(error=error),
    )  # fmt: skip
    return _followed(likelihood, moved)


def newton(space: Space, at: Reduced, z: Array, damping: float = 0.0) -> tuple[Array, float]:
    """The bounded step of the quadratic model, and what it promises [nats]."""
    h, slope = curvature(space, at), at.weight @ at.g + space.prior_pull(z)
    damped = h + damping * np.diag(np.diag(h))
    dz = step_within(damped, slope, z, space.low, space.high)
    return dz, float(slope @ dz - 0.5 * dz @ h @ dz)


def minimise(
    likelihood: Likelihood, start: Point, incumbent: float = np.inf, steps: int = STEPS
) -> Point:
    """Go from a start to the nearest optimum, the size falling from the start's.

    Args:
        likelihood: the windows.
        start: where to begin.
        incumbent: cost of a better hypothesis; a search that stays clearly above it is given up.
        steps: how many at most.
    """
    now, stale, damping, whole = start, 0.0, 1e-4, False
    for number in range(steps):
        dz, promised = newton(now.space, now.at, now.z, damping)
        moved = _moved(likelihood, now, dz)
        gained = -np.inf if moved is None else now.cost - moved.cost
        if moved is not None and gained >= -1e-9 * abs(now.cost):
            now, damping, stale = moved, max(0.1 * damping, 1e-6), stale + max(gained, 0.0)
        elif stale > 0.0:
            now, stale = fresh(likelihood, now), 0.0
            continue
        elif damping < _DAMPING_MAX and newton(now.space, now.at, now.z)[1] >= ENOUGH:
            damping *= 20.0
            continue
        size = likelihood.best_size(now.rotated, now.linear.error, now.x, now.size / FALL)
        there = abs(size - now.size) <= 0.01 * now.size
        if whole := there and max(promised, gained) < ENOUGH:
            break
        lower = with_size(likelihood, now, size)
        if number >= _UNTIL and there and lower.cost > incumbent + BEHIND:
            return replace(lower, whole=False)
        now = lower
        if abs(gained - promised) > _TRUST * max(promised, ENOUGH) or stale > _FAR:
            now, stale = fresh(likelihood, now), 0.0
    return replace(fresh(likelihood, now) if stale > 1.0 else now, whole=whole)


def step_within(h: Array, slope: Array, z: Array, low: Array, high: Array) -> Array:
    """The best step of the quadratic model within bounds.

    Newton's where that stays inside, else bounded least squares on the curvature's root (Stark and
    Parker, 1995). Clipping the step of coordinates that move together could go uphill.
    """
    dz = np.asarray(np.linalg.solve(h, slope), dtype=np.float64)
    if ((z + dz >= low) & (z + dz <= high)).all():
        return dz
    scale = 1.0 / np.sqrt(np.diag(h))
    spectrum, axes = np.linalg.eigh(0.5 * (h + h.T) * np.outer(scale, scale))
    root = np.sqrt(np.maximum(spectrum, _APART))
    room = np.where(high - low <= 0.0, _HAIR, np.maximum(high - z, 0.0))
    found = lsq_linear(
        root[:, None] * axes.T, axes.T @ (slope * scale) / root,
        (np.minimum(low - z, 0.0) / scale, room / scale), method="bvls", max_iter=_EXCHANGES,
    )  # fmt: skip
    inside: Array = np.clip(z + found.x * scale, low, high) - z
    return inside if slope @ inside >= 0.5 * inside @ h @ inside else np.zeros_like(z)
