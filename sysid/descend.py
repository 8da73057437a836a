"""Levenberg-Marquardt over coordinates and initial states together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.objective import (
    Evaluation,
    Normal,
    Problem,
    cost_of,
    information,
    normal_equations,
    robust_limit,
    solve,
)

Array = NDArray[np.float64]

DAMPING_MIN = 1e-10
DAMPING_MAX = 1e9


class Effort(NamedTuple):
    """How far to go.

    Attributes:
        iterations: accepted steps at most.
        step: end when a step is shorter, in standard deviations of the coordinates.
        drop: end when a step lowers the cost by a smaller share.
        damping: of the first step, relative to the diagonal.
    """

    iterations: int
    step: float
    drop: float
    damping: float = 1e-7


class Descent(NamedTuple):
    """Where the descent ended.

    Attributes:
        z: coordinates (n,); x: initial states (W, 7).
        at: the evaluation there.
        limit: where errors count as outliers.
        normal: Gauss-Newton equations there.
        costs: cost after each accepted step, the start's first.
        converged: whether the last step was short enough.
    """

    z: Array
    x: Array
    at: Evaluation
    limit: float
    normal: Normal
    costs: tuple[float, ...]
    converged: bool


def _trial(
    problem: Problem, normal: Normal, z: Array, x: Array, damping: float
) -> tuple[Array, Array]:
    """The damped step, within the bounds: coordinates that hit one stay there."""
    low, high = problem.chart.bounds()
    frozen = np.zeros(len(z), bool)
    for _ in range(len(z) + 1):
        dz, dx = solve(normal, damping, frozen)
        out = ((z + dz < low) & (z <= low)) | ((z + dz > high) & (z >= high))
        if not (out & ~frozen).any():
            break
        frozen |= out
    return np.clip(z + dz, low, high), x + dx


def descend(
    problem: Problem, z: Array, x: Array, effort: Effort, at: Evaluation | None = None
) -> Descent:
    """Minimise from a start; `at` is the evaluation there, if it is known.

    Raises:
        FloatingPointError: the simulation is not finite at the start.
    """
    at = at or problem.evaluate(z, x)
    if not at.finite:
        raise FloatingPointError("the simulation diverges at the start values")
    limit = robust_limit(at.error)
    costs, damping, converged = [cost_of(at, limit)], effort.damping, False
    normal = normal_equations(problem, at, limit)
    for _ in range(effort.iterations):
        cost = cost_of(at, limit)
        new, damping = _improve(problem, normal, (z, x, cost), limit, damping)
        if new is None:
            converged = True
            break
        step, drop = new[0] - z, cost - new[3]
        z, x, at = new[0], new[1], new[2]
        costs.append(new[3])
        limit = robust_limit(at.error)
        size = float(np.sqrt(max(step @ information(normal) @ step, 0.0)))
        normal = normal_equations(problem, at, limit)
        if size < effort.step or drop < effort.drop * new[3]:
            converged = True
            break
    return Descent(z, x, at, limit, normal, tuple(costs), converged)


def _improve(
    problem: Problem,
    normal: Normal,
    here: tuple[Array, Array, float],
    limit: float,
    damping: float,
) -> tuple[tuple[Array, Array, Evaluation, float] | None, float]:
    """The first damped step that lowers the cost, or None, and the damping for the next."""
    z, x, cost = here
    while damping < DAMPING_MAX:
        z_new, x_new = _trial(problem, normal, z, x, damping)
        at = problem.evaluate(z_new, x_new)
        lower = cost_of(at, limit)
        if lower < cost:
            return (z_new, x_new, at, lower), max(0.03 * damping, DAMPING_MIN)
        if cost - lower > -1e-9 * cost and np.abs(z_new - z).max(initial=0.0) < 1e-9:
            break
        damping *= 10.0
    return None, damping
