"""Levenberg-Marquardt over coordinates and initial states together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.estimation.bounded_step import step_within
from steerd.sysid.estimation.objective import (
    Evaluation,
    Normal,
    Problem,
    cost_of,
    eliminate,
    information,
    normal_equations,
    robust_limit,
)

Array = NDArray[np.float64]

DAMPING_MIN = 1e-10
DAMPING_MAX = 1e6
DAMPED = 1.0
"""Steps damped by more are short wherever the minimum is."""
GROWTH = 10.0
DROP_MIN = 0.01
"""A step that lowers the cost by less changes nothing that the data could show."""


class Effort(NamedTuple):
    """How far to go.

    Attributes:
        iterations: accepted steps at most.
        step: end when a step is shorter, in standard deviations of the coordinates.
        drop: end when a step lowers the cost by a smaller share.
        damping: of the first step, relative to the diagonal.
        patient: whether a step that is short because it was damped is no end.
    """

    iterations: int
    step: float
    drop: float
    damping: float = 1e-7
    patient: bool = False


class Solution(NamedTuple):
    """Where the iterations ended.

    Attributes:
        z: coordinates (n,); x: initial states (W, 7).
        at: the evaluation there.
        limit: where errors count as outliers.
        normal: Gauss-Newton equations there.
        costs: cost after each accepted step, the start's first.
        converged: whether the last step was short enough.
        damping: for iterations that go on from here.
    """

    z: Array
    x: Array
    at: Evaluation
    limit: float
    normal: Normal
    costs: tuple[float, ...]
    converged: bool
    damping: float


def damped_step(
    problem: Problem, normal: Normal, z: Array, x: Array, damping: float
) -> tuple[Array, Array]:
    """The damped step within the bounds, and the initial states' that belongs to it."""
    equations = eliminate(normal, damping)
    low, high = problem.chart.bounds()
    dz = step_within(equations.a, equations.slope, z, low, high)
    return np.clip(z + dz, low, high), x + equations.states(dz)


def minimise(
    problem: Problem, z: Array, x: Array, effort: Effort, at: Evaluation | None = None
) -> Solution:
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
        if gain_ahead(problem, normal, z) < effort.step**2:
            converged = True
            break
        new, damping = _improve(problem, normal, (z, x, cost), limit, damping)
        if new is None:
            converged = True
            break
        drop, size = cost - new[3], _length(normal, new[0] - z)
        z, x, at = new[0], new[1], new[2]
        costs.append(new[3])
        limit = robust_limit(at.error)
        normal = normal_equations(problem, at, limit)
        short = size < effort.step or drop < effort.drop * new[3] + DROP_MIN
        if short and not (effort.patient and damping >= DAMPED):
            converged = True
            break
    return Solution(z, x, at, limit, normal, tuple(costs), converged, damping)


def _length(normal: Normal, step: Array) -> float:
    """Length of a step of the coordinates in standard deviations."""
    square = float(step @ information(normal) @ step)
    return float(np.sqrt(max(square, 0.0)))


def gain_ahead(problem: Problem, normal: Normal, z: Array) -> float:
    """How far the minimum of the linearised problem lies, in squared standard deviations."""
    equations = eliminate(normal, 0.0)
    dz = step_within(equations.a, equations.slope, z, *problem.chart.bounds())
    by_states = float((normal.slope_x * equations.states(np.zeros(len(z)))).sum())
    return by_states + float(2.0 * equations.slope @ dz - dz @ equations.a @ dz)


def _improve(
    problem: Problem,
    normal: Normal,
    here: tuple[Array, Array, float],
    limit: float,
    damping: float,
) -> tuple[tuple[Array, Array, Evaluation, float] | None, float]:
    """The first damped step that lowers the cost, or None, and the damping for the next."""
    z, x, cost = here
    eased = max(0.1 * damping, DAMPING_MIN)
    while damping < DAMPING_MAX:
        z_new, x_new = damped_step(problem, normal, z, x, damping)
        at = problem.evaluate(z_new, x_new)
        lower = cost_of(at, limit)
        if lower < cost:
            return (z_new, x_new, at, lower), eased
        damping *= GROWTH
        eased = damping
    return None, damping
