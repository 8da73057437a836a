"""The best numbers of a hypothesis: Levenberg-Marquardt on the losses with eliminated starts."""

# Why: docs/decisions/diagnosis.md#d91

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.estimation.bounded_step import step_within
from steerd.sysid.inference.engine import Engine, Linear, Reduced, Tangent, take_windows
from steerd.sysid.inference.space import Space

Array = NDArray[np.float64]

STEPS = 12
ENOUGH = 0.2
"""A step that promises less than this many nats ends the search."""
_DAMPING_MAX = 1e6
_TRUST = 0.4
"""Derivatives are taken anew when a step gains this much more or less than it promised."""
_STALE, _STALE_LAST = 100.0, 2.0
"""And after this many nats; at the end already after fewer."""
_STALE_KNOWN = 1e-9
"""Derivatives of a point near the start count as such, until a step fails."""
_BEHIND = 60.0
"""A hypothesis that costs so much more than another does not compete with it [nats]."""
_AHEAD = 4.0
"""What is still to be gained, at most, per what the last step did: steps shrink."""
_LOST = 5.0
"""A window that leaves more than this of its whitened error may sit in a wrong start ..."""
_FOUND = 10.0
"""... and is taken up anew from the poses if that gains so much of its squares."""
LOST_LEAST, LOST_RATIO = 30.0, 6.0
"""A window this much worse than noise, and than the median, does not pull at all."""
_RETURNS = 3
"""Steps of such a start."""
_ROUNDS = 4
"""Steps of every window's start about one point ..."""
_OWED = 0.05
"""... and what may then be left of what such a step promises to take off a window's square."""
_SHORTER = 0.25
"""A start's step that led up is tried again so much shorter."""


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
        tangent: derivatives about there, whitened.
        linear: errors there and derivatives about there, as they are.
    """

    space: Space
    z: Array
    x: Array
    at: Reduced
    cost: float
    covariance: Array
    tangent: Tangent
    linear: Linear

    @property
    def parameters(self) -> Array:
        """(P,) all parameters of the superset."""
        return self.space.chart.parameters(self.z)

    @property
    def own(self) -> Array:
        """Values of the effects' parameters."""
        return self.z[self.space.nuisance :]

    @property
    def prior(self) -> Array:
        """(n,) deviation from the prior in its standard deviations."""
        away: Array = (self.z - self.space.centre) / self.space.spread
        return away


def total(space: Space, at: Reduced, z: Array) -> float:
    """Cost [nats]: losses and prior."""
    if not at.finite:
        return np.inf
    return float(at.loss.sum()) + space.prior_cost(z)


def curvature(space: Space, at: Reduced) -> Array:
    """(n, n) Gauss-Newton curvature of the cost, prior included."""
    weighted = np.einsum("w,wij->ij", at.weight, at.h)
    return np.asarray(weighted + space.precision)


def is_curved(space: Space, at: Reduced) -> bool:
    """Whether the cost rises along every coordinate.

    Where derivatives are so large that their differences are lost, its curvature is noise.
    """
    return bool((np.diag(curvature(space, at)) > 0.0).all())


def _slope(space: Space, at: Reduced, z: Array) -> Array:
    pull: Array = at.weight @ at.g + space.prior_pull(z)
    return pull


@dataclass
class _Search:
    """Where a search stands; derivatives may be those of an earlier point."""

    engine: Engine
    space: Space
    z: Array
    x: Array
    linear: Linear
    tangent: Tangent
    at: Reduced
    cost: float
    damping: float = 1e-4
    stale: float = 0.0
    """Nats gained since derivatives were taken."""

    def bounded(self, at: Reduced) -> Reduced:
        """The losses with this search's limit for lost windows."""
        return at._replace(limit=self.at.limit)

    def fresh(self) -> None:
        """Take derivatives here."""
        linear = self.engine.linear(self.space, self.z, self.x)
        if linear.finite:
            starts = settle_starts(self.engine, self.space, self.z, self.x, linear)
            self.x, self.linear, self.tangent, at = starts
            self.at = self.bounded(at)
            self.cost = total(self.space, self.at, self.z)
        self.stale = 0.0

    def restart(self) -> bool:
        """Take lost windows up anew from the poses' own starts, where that is better.

        The likelihood forgives a spun window, so nothing pulls its start back by itself.
        """
        lost = self.at.square > _LOST * self.at.dof
        if not lost.any():
            return False
        part = take_windows(self.engine, lost)
        x, square = _from_poses(part, self.space, self.z)
        better = square < self.at.square[lost] - _FOUND
        if not better.any():
            return False
        self.x = self.x.copy()
        self.x[np.flatnonzero(lost)[better]] = x[better]
        self.fresh()
        return True

    def move(self, dz: Array) -> float:
        """Try a step; give what it gains, and take it if it does."""
        x = self.x + self.at.dx - self.at.kx @ dz
        error, finite = self.engine.missed(self.space, self.z + dz, x)
        if not finite:
            return -np.inf
        trial = self.bounded(self.engine.reduce_by(self.tangent, error, x))
        gained = self.cost - total(self.space, trial, self.z + dz)
        if gained >= -1e-9 * abs(self.cost):
            self.z, self.x, self.at, self.cost = self.z + dz, x, trial, self.cost - gained
            self.linear = self.linear._replace(error=error)
            self.stale += max(gained, 0.0)
        return gained

    def step(self) -> tuple[float, float]:
        """One damped Newton step: nats promised and gained (0 if none was found)."""
        while self.damping < _DAMPING_MAX:
            h, slope = curvature(self.space, self.at), _slope(self.space, self.at, self.z)
            if not is_curved(self.space, self.at):
                raise FloatingPointError("derivatives are so large that their differences are lost")
            damped = h + self.damping * np.diag(np.diag(h))
            dz = step_within(damped, slope, self.z, self.space.low, self.space.high)
            promised = float(slope @ dz - 0.5 * dz @ h @ dz)
            gained = self.move(dz)
            if gained >= -1e-9 * abs(self.cost):
                self.damping = max(0.1 * self.damping, 1e-6)
                return promised, gained
            if self.stale > 0.0:
                self.fresh()
            elif 0.0 <= promised < ENOUGH:
                return promised, 0.0
            else:
                self.damping *= 20.0
        return 0.0, 0.0


def minimise(
    engine: Engine,
    space: Space,
    z: Array,
    x: Array,
    steps: int = STEPS,
    enough: float = ENOUGH,
    known: Linear | None = None,
    beat: float = np.inf,
) -> Fitted:
    """Go from a start to the nearest minimum of the cost.

    Derivatives are taken anew only where steps no longer do what they promise, and at the end.

    Args:
        engine: the windows.
        space: the coordinates.
        z: (n,) where to start.
        x: (W, 7) windows' starts there.
        steps: how many at most.
        enough: nats; a step that promises and gains less is the last.
        known: errors at the start and derivatives about it, of the same windows and coordinates,
            where somebody has them already.
        beat: cost of a better hypothesis; a search that stays clearly above it is given up.

    Raises:
        FloatingPointError: the simulation is not finite at the start, or too steep on the way.
    """
    linear = known or engine.linear(space, z, x)
    if not linear.finite:
        raise FloatingPointError("the simulation diverges at the start values")
    x, linear, tangent, at = settle_starts(engine, space, z, x, linear)
    at = at._replace(limit=lost_from(at))
    now = _Search(engine, space, z, x, linear, tangent, at, total(space, at, z))
    now.stale = _STALE_KNOWN if known else 0.0
    now.restart()
    _walk(now, steps, enough, beat)
    if not behind(now.cost, beat) and now.restart():
        _walk(now, steps, enough, beat)
    if now.stale > _STALE_LAST:
        now.fresh()
    covariance = covariance_of(space, now.at)
    return Fitted(space, now.z, now.x, now.at, now.cost, covariance, now.tangent, now.linear)


class Starts(NamedTuple):
    """Windows' starts at their best about one point: errors, derivatives and losses there."""

    x: Array
    linear: Linear
    tangent: Tangent
    at: Reduced


def settle_starts(engine: Engine, space: Space, z: Array, x: Array, linear: Linear) -> Starts:
    """Starts stepped, window by window, until a further step promises nothing.

    Losses count what a start's next step promises as taken. Where a window is so bent that no step
    keeps that promise, its start is held: else the search would compare every step with a cost
    that nothing reaches, and stop where it stands.

    Args:
        engine: the windows.
        space: the coordinates.
        z: (n,) where they are.
        x: (W, 7) windows' starts there.
        linear: errors and derivatives at `z` and `x`.
    """
    x, error, tangent = x.copy(), linear.error.copy(), engine.tangent(linear)
    at, square = engine.reduce_by(tangent, error, x), engine.square_at(error, x)
    share = np.ones(len(x))
    for _ in range(_ROUNDS):
        if not (square - at.square > _OWED).any():
            break
        tried = x + share[:, None] * at.dx
        off, _ = engine.missed(space, z, tried)
        left = engine.square_at(off, tried)
        better = left < square
        x[better], error[better], square[better] = tried[better], off[better], left[better]
        share = np.where(better, 1.0, _SHORTER * share)
        at = engine.reduce_by(tangent, error, x)
    held = square - at.square > _OWED
    if held.any():
        tangent = tangent.holding(held)
        at = engine.reduce_by(tangent, error, x)
    return Starts(x, linear._replace(error=error), tangent, at)


def lost_from(at: Reduced) -> float:
    """Squared error per degree of freedom from which a window is lost to the search."""
    return max(LOST_LEAST, LOST_RATIO * float(np.median(at.square / at.dof)))


def behind(cost: float, beat: float, ahead: float = 0.0) -> bool:
    """Whether a hypothesis is worse than another beyond doubt, whatever it may still gain."""
    return cost - ahead > beat + _BEHIND


def _walk(now: _Search, steps: int, enough: float, beat: float) -> None:
    """Steps until one promises and gains too little, or too little to catch up."""
    for _ in range(steps):
        promised, gained = now.step()
        if max(gained, promised) < enough:
            break
        if behind(now.cost, beat, _AHEAD * max(gained, promised)):
            break
        if abs(gained - promised) > _TRUST * promised or now.stale > _STALE:
            now.fresh()


def _from_poses(part: Engine, space: Space, z: Array) -> tuple[Array, Array]:
    """Starts (W, 7) of some windows, settled from the poses' guesses, and what they leave (W,)."""
    x = part.readings.layout.guess.copy()
    best, square = x.copy(), np.full(len(x), np.inf)
    for _ in range(_RETURNS):
        linear = part.linear(space, z, x)
        if not linear.finite:
            break
        at = part.reduce_by(part.tangent(linear), linear.error, x)
        better = at.square < square
        # The square is that after the step which follows; it is kept as if that step held.
        best[better], square[better] = (x + at.dx)[better], at.square[better]
        x = x + at.dx
    return best, square


def covariance_of(space: Space, at: Reduced) -> Array:
    """(n, n) covariance of the coordinates."""
    h = curvature(space, at)
    return np.asarray(np.linalg.inv(0.5 * (h + h.T)))
