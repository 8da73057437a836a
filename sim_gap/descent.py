"""The best numbers of a hypothesis: Levenberg-Marquardt on the losses with eliminated starts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_gap.engine import Engine, Reduced
from sim_gap.space import Space

Array = NDArray[np.float64]

STEPS = 12
ENOUGH = 0.2
"""A step that promises less than this many nats ends the descent."""
_DAMPING_MAX = 1e6


@dataclass(frozen=True, eq=False)
class Fitted:
    """A hypothesis at its best.

    Attributes:
        space: its coordinates.
        z: (n,) the best of them.
        x: (W, 7) windows' starts.
        at: losses about there.
        cost: sum of the losses and half the prior's square [nats].
        covariance: (n, n) of the coordinates.
    """

    space: Space
    z: Array
    x: Array
    at: Reduced
    cost: float
    covariance: Array

    @property
    def parameters(self) -> Array:
        """(P,) all parameters of the superset."""
        return self.space.chart.parameters(self.z)

    @property
    def own(self) -> Array:
        """Values of the effects' parameters."""
        return self.z[self.space.nuisance :]

    @property
    def own_sd(self) -> Array:
        """Their standard errors."""
        sd: Array = np.sqrt(np.diag(self.covariance)[self.space.nuisance :])
        return sd

    @property
    def prior(self) -> Array:
        """(n,) deviation from the prior in its standard deviations."""
        away: Array = (self.z - self.space.centre) / self.space.spread
        return away


def total(space: Space, at: Reduced, z: Array) -> float:
    """Cost [nats]: losses and prior."""
    if not at.finite:
        return np.inf
    away = (z - space.centre) / space.spread
    return float(at.loss.sum() + 0.5 * away @ away)


def curvature(space: Space, at: Reduced) -> Array:
    """(n, n) Gauss-Newton curvature of the cost, prior included."""
    weighted = np.einsum("w,wij->ij", at.weight, at.h)
    return np.asarray(weighted + np.diag(space.spread**-2.0))


def _slope(space: Space, at: Reduced, z: Array) -> Array:
    pull: Array = at.weight @ at.g + (space.centre - z) / space.spread**2
    return pull


def step_within(h: Array, slope: Array, z: Array, low: Array, high: Array) -> Array:
    """Newton's step within bounds: coordinates that would leave at a bound stay there."""
    frozen = np.zeros(len(z), bool)
    dz = np.zeros(len(z))
    for _ in range(len(z) + 1):
        free = ~frozen
        dz = np.zeros(len(z))
        if free.any():
            dz[free] = np.linalg.solve(h[np.ix_(free, free)], slope[free])
        out = ((z + dz < low) & (z <= low)) | ((z + dz > high) & (z >= high))
        if not (out & ~frozen).any():
            break
        frozen |= out
    inside: Array = np.clip(z + dz, low, high) - z
    return inside


def descend(
    engine: Engine, space: Space, z: Array, x: Array, steps: int = STEPS, enough: float = ENOUGH
) -> Fitted:
    """Go from a start to the nearest minimum of the cost.

    Raises:
        FloatingPointError: the simulation is not finite at the start.
    """
    at = engine.reduce(space, z, x)
    cost = total(space, at, z)
    if not np.isfinite(cost):
        raise FloatingPointError("the simulation diverges at the start values")
    damping = 1e-4
    for _ in range(steps):
        h, slope = curvature(space, at), _slope(space, at, z)
        promised = gained = 0.0
        while damping < _DAMPING_MAX:
            dz = step_within(h + damping * np.diag(np.diag(h)), slope, z, space.low, space.high)
            promised = float(slope @ dz - 0.5 * dz @ h @ dz)
            x_new = x + at.dx - at.kx @ dz
            trial = engine.reduce(space, z + dz, x_new)
            lower = total(space, trial, z + dz)
            if lower <= cost + 1e-9 * abs(cost):
                gained, z, x, at, cost = cost - lower, z + dz, x_new, trial, lower
                damping = max(0.1 * damping, 1e-6)
                break
            if promised < enough:
                gained = 0.0
                break
            damping *= 20.0
        else:
            break
        if max(gained, promised) < enough:
            break
    return Fitted(space, z, x, at, cost, covariance_of(space, at))


def covariance_of(space: Space, at: Reduced) -> Array:
    """(n, n) covariance of the coordinates."""
    h = curvature(space, at)
    return np.asarray(np.linalg.inv(0.5 * (h + h.T)))
