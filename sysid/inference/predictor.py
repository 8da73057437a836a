"""The prediction error of windows, and its derivatives.

Unknown are the coordinates `z` (n,) of a hypothesis and each window's start `x` (W, 7).
"""

# Why: docs/decisions/diagnosis.md#d51

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from steerd.car_model.chassis import KINEMATIC_RATE, dynamic_share
from steerd.car_model.native.windows import (
    STATES,
    HeldCommands,
    Windows,
    compute_readings,
    delays_of,
    model_of,
)
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.params import Car
from steerd.car_model.rollout import stiffness_rate
from steerd.sysid.data.data_checks import Array, Indices, Mask
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import (
    SPACING,
    Layout,
    make_layout,
    make_stations,
    take_windows,
    thinned,
)
from steerd.sysid.inference.augmented_car import AugmentedCar
from steerd.sysid.inference.space import Space

HORIZON = 1.0  # length of a window [s]: delays, gains and tyres show, nothing compounds yet
INTEGRATOR = "midpoint"
"""Half the work of `rk4`; on a grid of 5 ms a position differs by 0.01 mm after a second."""
STATE_SPREAD = np.array([0.1, 0.1, 0.2, 0.5, 2.0, 0.2, 0.01])
"""Prior standard deviation of a start about its first guess (poses show it far better)."""
STEER_SPREAD_UNKNOWN = 0.2
"""That of its steering angle where the commands before the window are not known [rad]."""
STEER_SPREAD = 0.003  # how far the steering may be from where the known commands bring it [rad]
FREE_STATES = 6  # states of a start that its window determines: they take degrees of freedom
WILD = 1e3
"""Errors beyond this are a simulation that left the map [m, rad, m/s, rad/s]. Derivatives beyond it
count as none: squared and weighed by millimetres they leave no digits."""
WILD_SHARE = 0.5  # share of such windows above which the whole simulation counts as diverged
WILD_ERROR = 1.0  # every reading of such a window is off by this, whatever is changed [m, rad, ...]
DECAY_MAX = {"rk4": 2.0, "midpoint": 1.4}
"""Decay per step that is surely stable (the limits are 2.78 and 2)."""
SUBSTEPS_MAX = 16


class Padded(NamedTuple):
    """Rows by window."""

    row: Indices  # (W, D) place among all rows, of the first where several are averaged
    there: Array  # (W, D) 1 where there is one
    merged: Array  # (W, D) how many are averaged
    weights: csr_array  # (W * D, R) of the averages


class Alike(NamedTuple):
    """Windows that are integrated in steps of the same length."""

    chosen: Mask  # (W,) which; rows: (R,) theirs
    rows: Mask
    layout: Layout  # they alone
    held: HeldCommands  # the commands as they are integrated over
    windows: Windows  # in integration steps


class Linear(NamedTuple):
    """Errors about one point."""

    error: Array  # (W, D) measurement minus prediction, zero where there is no row
    by_z: Array  # (W, D, n) derivative of the prediction by the coordinates
    by_x: Array  # (W, D, 7) by the window's start
    finite: bool  # whether the simulation stayed finite


@dataclass(frozen=True, eq=False)
class Predictor:
    """Windows of a session seen by the augmented car of all effects."""

    augmented: AugmentedCar  # the car
    layout: Layout  # the windows
    padded: Padded  # rows by window
    substeps: Indices  # (W,) integration steps to a command
    means: bool = False  # see `open_predictor`

    @property
    def guess(self) -> Array:
        """(W, 7) first guess of the windows' starts."""
        return self.layout.guess

    @cached_property
    def finest(self) -> Alike:
        """All windows, integrated in the steps of the one that needs the shortest."""
        return self._alike(np.ones(len(self.substeps), bool), int(self.substeps.max()))

    @cached_property
    def alike(self) -> list[Alike]:
        """The windows by how long their steps are."""
        return [self._alike(self.substeps == n, n) for n in np.unique(self.substeps).tolist()]

    def _alike(self, chosen: Mask, steps: int) -> Alike:
        rows, layout = chosen[self.layout.window], take_windows(self.layout, chosen)
        held = HeldCommands(layout.commands, layout.h, steps, INTEGRATOR)
        return Alike(chosen, rows, layout, held, layout.kernel_windows(steps))

    @property
    def channel(self) -> Indices:
        """(W, D) channel of each row, see `Layout.channel`."""
        return np.asarray(self.layout.channel[self.padded.row])

    @property
    def start_spread(self) -> Array:
        """(W, 7) prior standard deviations of the starts about their first guesses."""
        spread = np.tile(STATE_SPREAD, (self.layout.count, 1))
        spread[:, 6] = np.where(self.layout.has_past, STEER_SPREAD, STEER_SPREAD_UNKNOWN)
        return spread

    @cached_property
    def pace(self) -> Array:
        """(W,) mean commanded speed [m/s]."""
        layout = self.layout
        return np.array([np.abs(layout.commands[a : a + n, 1]).mean()
                         for _, _, a, n, _ in layout.spans])  # fmt: skip

    @cached_property
    def lateral(self) -> Array:
        """(W,) mean lateral acceleration of the windows, from poses and commands [m/s^2]."""
        layout, turned = self.layout, np.zeros(self.layout.count)
        for w in range(layout.count):
            rows = layout.rows(w)
            turn = layout.channel[rows] == 2
            yaw, t = np.unwrap(layout.values[rows][turn]), layout.row_t[rows][turn]
            if len(t) > 1:
                turned[w] = np.abs(np.diff(yaw)).sum() / max(t[-1] - t[0], 1e-3)
        return np.asarray(self.pace * turned)

    def pad(self, rows: Array) -> Array:
        """(R, ...) rows as (W, D, ...), zero where there is none."""
        padded = self.padded.weights @ rows.reshape(len(rows), -1)
        return np.asarray(padded.reshape(*self.padded.there.shape, *rows.shape[1:]))

    def linear(self, space: Space, z: Array, x: Array) -> Linear:
        """Errors and derivatives at coordinates `z` and starts `x`."""
        return self._linear(space.chart.parameters(z), space.chart.slopes(z), x)

    def by_starts(self, parameters: Array, x: Array) -> tuple[Array, Array]:
        """Errors (W, D) and derivatives (W, D, 7) by the starts alone."""
        found = self._linear(parameters, np.zeros((len(parameters), 0)), x)
        return found.error, found.by_x

    def _linear(self, parameters: Array, slopes: Array, x: Array) -> Linear:
        n = slopes.shape[1]
        seeds = np.zeros((len(parameters), n + STATES))
        seeds[:, :n] = slopes
        dfirst = np.zeros((STATES, n + STATES))
        dfirst[:, n:] = np.eye(STATES)
        error, jy = self._simulate(parameters, seeds, x, dfirst)
        error, finite = self._without_wild(error)
        by_z, by_x = jy[:, :, :n], jy[:, :, n:]
        jy[~(np.abs(by_x).max(axis=(1, 2)) < WILD)] = 0.0
        by_z[~(np.abs(by_z).max(axis=(1, 2), initial=0.0) < WILD)] = 0.0
        return Linear(error, by_z, by_x, finite)

    def errors(self, parameters: Array, x: Array) -> tuple[Array, bool]:
        """Errors (W, D) of the car with parameters (P,) alone; whether they are finite."""
        none = np.zeros((len(parameters), 0))
        error, _ = self._simulate(parameters, none, x, np.zeros((STATES, 0)))
        return self._without_wild(error)

    def _simulate(
        self, parameters: Array, seeds: Array, x: Array, dfirst: Array
    ) -> tuple[Array, Array]:
        """(W, D) measurements minus readings, angles the short way round; slopes of readings."""
        layout, kernels = self.layout, self.augmented.kernels
        late = float(delays_of(kernels, parameters)[2])
        y, jy = np.empty(n := len(layout.values)), np.empty((n, seeds.shape[1]))
        for part in self.alike:
            y[part.rows], jy[part.rows] = compute_readings(
                kernels, parameters, seeds, x[part.chosen], dfirst, part.held,
                part.windows, make_stations(part.layout, late, part.held.fine),
            )  # fmt: skip
        error, turn = layout.values - y, layout.channel == 2
        with np.errstate(invalid="ignore"):  # a window that left the map
            error[turn] = (error[turn] + np.pi) % (2.0 * np.pi) - np.pi
        return self.pad(error), self.pad(jy) if jy.size else jy

    def _without_wild(self, error: Array) -> tuple[Array, bool]:
        """Errors, of a fixed size in windows that left the map, and whether these are few."""
        wild = ~(np.abs(error).max(axis=1) < WILD)
        error[wild] = WILD_ERROR * self.padded.there[wild]
        return error, bool(wild.mean() <= WILD_SHARE)

    def about_guess(self, x: Array, linear: Linear) -> tuple[Array, Array]:
        """Errors (W, D) about the starts' first guesses, by the linear model about starts `x`.

        Beside them what unknown starts add to their covariance (W, D, D).
        """
        error = linear.error + np.einsum("wij,wj->wi", linear.by_x, x - self.guess)
        wide = linear.by_x * self.start_spread[:, None, :]
        return np.asarray(error), np.asarray(wide @ wide.transpose(0, 2, 1))

    def stepped_for(self, parameters: Array) -> "Predictor":
        """The same with steps as short as a car (P,) needs, if its own are longer."""
        car, layout = model_of(self.augmented.kernels, parameters).car, self.layout
        speeds = layout.window_speeds.tolist()
        needed = [stable_substeps(car, low, high, layout.h, INTEGRATOR) for low, high in speeds]
        return replace(self, substeps=np.maximum(self.substeps, needed))

    def take(self, chosen: Mask) -> "Predictor":
        """The predictor on some of its windows (boolean mask (W,))."""
        layout = take_windows(self.layout, chosen)
        padded, substeps = pad_rows(layout, self.means), self.substeps[chosen]
        return replace(self, layout=layout, padded=padded, substeps=substeps)


def pad_rows(layout: Layout, means: bool) -> Padded:
    """Where the rows of each window lie.

    With `means`, those of one window, channel and multiple of `SPACING` are averaged.
    """
    window = layout.window
    first = member = np.arange(len(window))
    counts = np.ones(len(window))
    if means:
        time = np.round(layout.row_t / SPACING).astype(np.int64)
        kind = np.maximum(layout.channel - 2, 0)
        slot = ((window * 3 + kind) * 100_000 + time) * 5 + layout.channel
        _, first, member, counts = np.unique(
            slot, return_index=True, return_inverse=True, return_counts=True
        )
    bounds = np.searchsorted(window[first], np.arange(layout.count + 1))
    number = np.arange(int(np.diff(bounds).max()))[None, :]
    there = number < np.diff(bounds)[:, None]
    place = bounds[:-1, None] + number * there
    weights = csr_array(
        (1.0 / counts[member], (np.flatnonzero(there)[member], np.arange(len(window)))),
        shape=(there.size, len(window)),
    )
    merged = np.where(there, counts[place], 1.0)
    return Padded(first[place], there.astype(float), merged, weights)


def open_predictor(
    augmented: AugmentedCar,
    runs: Sequence[Run],
    horizon: float = HORIZON,
    most: float = np.inf,
    means: bool = False,
    late: float | None = None,
) -> Predictor:
    """The windows of some drives as the augmented car is simulated over them.

    Args:
        augmented: the car.
        runs: on one grid.
        horizon: length of a window [s]; a longer one has as many readings, further apart.
        most: take windows of so much driving in all, evenly from the whole [s].
        means: compare means over `SPACING` instead of single readings: where instruments' noise is
            all that is random, every reading counts.
        late: how late poses are [s]; None for what the augmented's base says.

    Raises:
        ValueError: the runs' grids differ, or no window sees enough poses.
    """
    known = float(augmented.base[augmented.kernels.names.index("pose_delay")])
    layout = make_layout(runs, horizon, known if late is None else late, most)
    layout = layout if means else thinned(layout, SPACING * max(horizon / HORIZON, 1.0))
    padded = pad_rows(layout, means)
    once = np.ones(layout.count, np.int64)
    return Predictor(augmented, layout, padded, once, means).stepped_for(augmented.base)


def stable_substeps(
    car: Car[float], slowest: float, fastest: float, h: float, integrator: str = "rk4"
) -> int:
    """Integration steps that a step of `h` seconds needs for speeds in this range [m/s].

    Below walking pace the tyre equations fade into the kinematic ones, so that the fastest decay of
    yaw rate and slip stays bounded.
    """
    speeds = np.linspace(slowest, fastest, 32)
    share = np.asarray(dynamic_share(NUMPY, speeds), float)
    tyres = np.array([stiffness_rate(car, float(v)) for v in speeds])
    rate = float(np.max(share * tyres + (1.0 - share) * KINEMATIC_RATE))
    if not math.isfinite(rate):
        return SUBSTEPS_MAX
    return min(max(1, math.ceil(h * rate / DECAY_MAX[integrator])), SUBSTEPS_MAX)
