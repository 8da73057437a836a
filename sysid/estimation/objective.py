"""What the fit minimises: whitened multi-step prediction errors, robust, with weak priors.

Unknown are the free coordinates `z` (n,) and each window's initial state `x` (W, 7); the latter are
eliminated from each step's equations (Schur complement), as they touch one window each.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.native.windows import (
    START_POSE,
    HeldCommands,
    Kernels,
    Stations,
    compute_readings,
    delays_of,
    model_of,
)
from steerd.sysid.data.windows import GROUPS, Layout
from steerd.sysid.estimation.chart import Chart
from steerd.sysid.estimation.stability import stable_substeps

Array = NDArray[np.float64]

STATES = 7
COLUMN_STATES = (3, 4, 5, 6, 0, 1, 2)
"""Which state each of the last seven columns of slopes belongs to: the place and heading last."""
STATE_SPREAD = np.array([0.1, 0.1, 0.2, 0.5, 2.0, 0.2, 0.01])
"""Prior standard deviation of an initial state about its first guess (poses show it far better).

The last is the steering angle's deviation from where the known commands bring it.
"""
STEER_SPREAD_UNKNOWN = 0.2
"""The same where the commands before the window are not known [rad]."""
HUBER = 3.0
"""Errors beyond this many standard deviations pull no harder."""


class Evaluation(NamedTuple):
    """The objective at one point.

    Attributes:
        error: (R,) whitened measurement minus prediction.
        slopes: (R, n + 7) whitened derivative of the prediction by `z` and its window's state, the
            latter in the order of `COLUMN_STATES`.
        prior_z: (n,) whitened deviation of the coordinates from their prior.
        prior_x: (W, 7) the same for the initial states.
        finite: whether the simulation stayed finite.
    """

    error: Array
    slopes: Array
    prior_z: Array
    prior_x: Array
    finite: bool


@dataclass(eq=False)
class Problem:
    """Windows to be explained by a car.

    Attributes:
        kernels: the compiled car.
        chart: coordinates of the free parameters.
        layout: windows and measurements.
        sigma: (4,) noise of each group.
        speeds: slowest and fastest [m/s], for the step size.
        integrator: `rk4` or `euler`.
        substeps: integration steps to a command; None chooses stable ones at each evaluation.
    """

    kernels: Kernels
    chart: Chart
    layout: Layout
    sigma: Array
    speeds: tuple[float, float]
    integrator: str = "rk4"
    substeps: int | None = None
    evaluations: int = 0
    _stations: dict[tuple[float, float], Stations] = field(default_factory=dict)

    @property
    def spread_x(self) -> Array:
        """(W, 7) prior standard deviations of the initial states."""
        spread = np.tile(STATE_SPREAD, (len(self.layout.spans), 1))
        spread[~self.layout.has_past, 6] = STEER_SPREAD_UNKNOWN
        return spread

    def evaluate(self, z: Array, x: Array) -> Evaluation:
        """Errors and derivatives at coordinates `z` and initial states `x`."""
        self.evaluations += 1
        with np.errstate(over="ignore", invalid="ignore"):  # far starts may diverge
            return self._evaluate(z, x)

    def _evaluate(self, z: Array, x: Array) -> Evaluation:
        parameters = self.chart.parameters(z)
        scale = 1.0 / self.sigma[self.layout.group]
        y, jy = self._read(parameters, z, x, scale)
        error = self.layout.values - y
        yaw = self.layout.group == GROUPS.index("yaw")
        error[yaw] = (error[yaw] + np.pi) % (2.0 * np.pi) - np.pi
        prior_z = (self.chart.coordinates(self.chart.prior) - z) / self.chart.spread
        prior_x = (self.layout.guess - x) / self.spread_x
        error *= scale
        finite = bool(np.isfinite(error).all() and self.chart.allowed(parameters))
        return Evaluation(error, jy, prior_z, prior_x, finite)

    def _read(self, parameters: Array, z: Array, x: Array, scale: Array) -> tuple[Array, Array]:
        n, layout = len(z), self.layout
        substeps = self.substeps or stable_substeps(
            model_of(self.kernels, parameters).car, *self.speeds, layout.h
        )
        held = HeldCommands(layout.commands, layout.h, substeps, self.integrator)
        late = float(delays_of(self.kernels, parameters)[2])
        key = (late, held.fine)
        if key not in self._stations:
            self._stations = {key: layout.stations(late, held.fine)}
        # Without effects nothing depends on where the car is: moved and turned starts move and turn
        # the poses, and these columns need no simulation.
        start_pose = not self.kernels.effects
        used = n + STATES - (START_POSE if start_pose else 0)
        seeds = np.zeros((len(parameters), used))
        seeds[:, :n] = self.chart.slopes(z)
        dfirst = np.zeros((STATES, used))
        dfirst[COLUMN_STATES[: used - n], range(n, used)] = 1.0
        return compute_readings(
            self.kernels, parameters, seeds, x, dfirst, held, layout.kernel_windows(substeps),
            self._stations[key], scale, start_pose,
        )  # fmt: skip

    def rescaled(self, at: Evaluation, sigma: Array) -> Evaluation:
        """Take other noise levels, and give the same evaluation under them."""
        ratio = (self.sigma / sigma)[self.layout.group]
        self.sigma = sigma
        return at._replace(error=at.error * ratio, slopes=at.slopes * ratio[:, None])


def robust_limit(error: Array) -> float:
    """Where errors begin to count as outliers: wider while the whole fit is still poor."""
    return HUBER * max(1.0, float(np.median(np.abs(error))) / 0.6745)


def cost_of(at: Evaluation, limit: float) -> float:
    """Huber's loss of the errors plus the priors' halves of squares; infinite off the map."""
    if not at.finite:
        return np.inf
    size = np.abs(at.error)
    near = np.minimum(size, limit)
    loss = near * (size - 0.5 * near)
    return float(loss.sum() + 0.5 * (at.prior_z**2).sum() + 0.5 * (at.prior_x**2).sum())


class Normal(NamedTuple):
    """Gauss-Newton equations: parameters `a`, cross `b` (W, n, 7), states `d` (W, 7, 7), slopes."""

    a: Array
    b: Array
    d: Array
    slope_z: Array
    slope_x: Array


def normal_equations(problem: Problem, at: Evaluation, limit: float) -> Normal:
    """Gauss-Newton equations with Huber's weights."""
    n, bounds = len(at.prior_z), problem.layout.bounds
    weight = limit / np.maximum(np.abs(at.error), limit)
    count = len(bounds) - 1
    squares = np.empty((count, n + STATES, n + STATES))
    pulls = np.empty((count, n + STATES))
    for w in range(count):
        mine = slice(bounds[w], bounds[w + 1])
        slopes = at.slopes[mine]
        weighed = slopes * weight[mine, None]
        squares[w], pulls[w] = weighed.T @ slopes, weighed.T @ at.error[mine]
    order = [*range(n), *(n + np.argsort(COLUMN_STATES))]
    squares, pulls = squares[:, order][:, :, order], pulls[:, order]
    spread = problem.spread_x
    d = squares[:, n:, n:].copy()
    d[:, range(STATES), range(STATES)] += 1.0 / spread**2
    return Normal(
        squares[:, :n, :n].sum(axis=0) + np.diag(problem.chart.spread**-2),
        squares[:, :n, n:],
        d,
        pulls[:, :n].sum(axis=0) + at.prior_z / problem.chart.spread,
        pulls[:, n:] + at.prior_x / spread,
    )


def _damped(matrices: Array, damping: float) -> Array:
    out = matrices.copy()
    axis = range(matrices.shape[-1])
    out[..., axis, axis] *= 1.0 + damping
    return out


class Eliminated(NamedTuple):
    """Equations of the coordinates alone, and what brings the initial states back.

    Attributes:
        a: (n, n) curvature.
        slope: (n,) downhill.
        inner: (W, 7, n + 1) states' step is the last column less the others times the coordinates'.
    """

    a: Array
    slope: Array
    inner: Array

    def states(self, dz: Array) -> Array:
        """(W, 7) step of the initial states that belongs to one of the coordinates."""
        step: Array = self.inner[:, :, -1] - self.inner[:, :, :-1] @ dz
        return step


def eliminate(normal: Normal, damping: float) -> Eliminated:
    """The equations with their diagonals raised by `damping`, initial states eliminated."""
    d = _damped(normal.d, damping)
    columns = np.concatenate([normal.b.transpose(0, 2, 1), normal.slope_x[:, :, None]], axis=2)
    inner = np.linalg.solve(d, columns)
    s = _damped(normal.a, damping) - np.einsum("wnk,wkm->nm", normal.b, inner[:, :, :-1])
    right = normal.slope_z - np.einsum("wnk,wk->n", normal.b, inner[:, :, -1])
    return Eliminated(s, right, inner)


def information(normal: Normal) -> Array:
    """Information about the coordinates, priors included, initial states eliminated (n, n)."""
    inner = np.linalg.solve(normal.d, normal.b.transpose(0, 2, 1))
    left: Array = normal.a - np.einsum("wnk,wkm->nm", normal.b, inner)
    return 0.5 * (left + left.T)
