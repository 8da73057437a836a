"""The prediction error of windows, and its derivatives.

Unknown are the coordinates `z` (n,) of a hypothesis and each window's start `x` (W, 7).
"""

# Why: docs/decisions/diagnosis.md#d51

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from steerd.car_model.chassis import KINEMATIC_RATE, dynamic_share
from steerd.car_model.native.windows import (
    STATES,
    HeldCommands,
    Stations,
    compute_readings,
    delays_of,
    model_of,
)
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.params import Car
from steerd.car_model.rollout import stiffness_rate
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import speed_range
from steerd.sysid.inference.knowledge import EDGES
from steerd.sysid.inference.readings import HORIZON, Readings, make_readings
from steerd.sysid.inference.space import Space
from steerd.sysid.inference.superset import Superset
from steerd.sysid.inference.values import INTEGRATOR, predicted

Array = NDArray[np.float64]

STATE_SPREAD = np.array([0.1, 0.1, 0.2, 0.5, 2.0, 0.2, 0.01])
"""Prior standard deviation of a start about its first guess (poses show it far better)."""
STEER_SPREAD_UNKNOWN = 0.2
"""That of its steering angle where the commands before the window are not known [rad]."""
STEER_SPREAD = 0.003
"""How far the steering may be from where the known commands bring it [rad]."""
FREE_STATES = 6
"""States of a start that the window itself determines: what they take is no degree of freedom."""
WILD = 1e3
"""Errors beyond this are a simulation that left the map [m, rad, m/s, rad/s]."""
WILD_SHARE = 0.5
"""Share of such windows above which the whole simulation counts as diverged."""
WILD_ERROR = 1.0
"""What every reading of such a window is taken to be off by, whatever is changed [m, rad, ...]."""
DECAY_MAX = {"rk4": 2.0, "midpoint": 1.4, "euler": 1.4}
"""Decay per step that is surely stable (the limits are 2.78, 2 and 2)."""
SUBSTEPS_MAX = 16


class Padded(NamedTuple):
    """Rows by window.

    Attributes:
        row: (W, D) place among all rows, of the first where several are averaged.
        there: (W, D) 1 where there is one.
        merged: (W, D) how many are averaged.
        means: (W * D, R) weights of the averages; None where each is one row.
    """

    row: NDArray[np.int64]
    there: Array
    merged: Array
    means: csr_array | None = None


class Linear(NamedTuple):
    """Errors about one point.

    Attributes:
        error: (W, D) measurement minus prediction, zero where there is no row.
        by_z: (W, D, n) derivative of the prediction by the coordinates.
        by_x: (W, D, 7) by the window's start.
        finite: whether the simulation stayed finite.
    """

    error: Array
    by_z: Array
    by_x: Array
    finite: bool


@dataclass(frozen=True, eq=False)
class Engine:
    """Windows of a session seen by the superset of all effects.

    Attributes:
        superset: the car.
        readings: the windows.
        padded: rows by window.
        substeps: integration steps to a command.
    """

    superset: Superset
    readings: Readings
    padded: Padded
    substeps: int

    @property
    def start_spread(self) -> Array:
        """(W, 7) prior standard deviations of the starts about their first guesses."""
        layout = self.readings.layout
        spread = np.tile(STATE_SPREAD, (len(layout.spans), 1))
        spread[:, 6] = np.where(layout.has_past, STEER_SPREAD, STEER_SPREAD_UNKNOWN)
        return spread

    @property
    def lateral(self) -> Array:
        """(W,) mean lateral acceleration of the windows, from poses and commands [m/s^2]."""
        layout, readings = self.readings.layout, self.readings
        out = np.zeros(readings.count)
        for w, (_, _, first, steps, _) in enumerate(layout.spans):
            rows = readings.rows(w)
            turn = readings.channel[rows] == 2
            yaw, t = np.unwrap(layout.values[rows][turn]), readings.t[rows][turn]
            speed = np.abs(layout.commands[first : first + steps, 1]).mean()
            if len(t) > 1:
                out[w] = speed * np.abs(np.diff(yaw)).sum() / max(t[-1] - t[0], 1e-3)
        return out

    def pad(self, rows: Array) -> Array:
        """(R, ...) rows as (W, D, ...), zero where there is none."""
        there, means = self.padded.there, self.padded.means
        if means is not None:
            return np.asarray(
                (means @ rows.reshape(len(rows), -1)).reshape(*there.shape, *rows.shape[1:])
            )
        shaped = there.reshape(there.shape + (1,) * (rows.ndim - 1))
        with np.errstate(invalid="ignore"):  # a window that left the map
            padded: Array = rows[self.padded.row] * shaped
        return padded

    def linear(self, space: Space, z: Array, x: Array) -> Linear:
        """Errors and derivatives at coordinates `z` and starts `x`."""
        parameters, n = space.chart.parameters(z), len(z)
        kernels, layout = self.superset.kernels, self.readings.layout
        held = HeldCommands(layout.commands, layout.h, self.substeps, INTEGRATOR)
        seeds = np.zeros((len(parameters), n + STATES))
        seeds[:, :n] = space.chart.slopes(z)
        dfirst = np.zeros((STATES, n + STATES))
        dfirst[:, n:] = np.eye(STATES)
        y, jy = compute_readings(
            kernels, parameters, seeds, x, dfirst, held, layout.kernel_windows(self.substeps),
            self._stations(parameters, held.fine),
        )  # fmt: skip
        error, jy = self.pad(self._off(y)), self.pad(jy)
        wild = ~((np.abs(error).max(axis=1) < WILD) & (np.abs(jy).max(axis=(1, 2)) < WILD**2))
        jy[wild] = 0.0
        error, finite = self._without(wild, error)
        return Linear(error, jy[:, :, :n], jy[:, :, n:], finite)

    def _off(self, y: Array) -> Array:
        """(R,) measurements minus readings, angles the short way round."""
        error = self.readings.layout.values - y
        turn = self.readings.channel == 2
        with np.errstate(invalid="ignore"):  # a window that left the map
            error[turn] = (error[turn] + np.pi) % (2.0 * np.pi) - np.pi
        return error

    def _without(self, wild: NDArray[np.bool_], error: Array) -> tuple[Array, bool]:
        """Errors, of a fixed size in windows that left the map, and whether these are few."""
        error[wild] = WILD_ERROR * self.padded.there[wild]
        return error, bool(wild.mean() <= WILD_SHARE)

    def _stations(self, parameters: Array, step: float) -> Stations:
        late = float(delays_of(self.superset.kernels, parameters)[2])
        return self.readings.layout.stations(late, step)

    @property
    def excess(self) -> Array:
        """(W,) how much larger than noise healthy errors are where the car corners so hard."""
        known = self.superset.knowledge
        if known is None:
            return np.ones(self.readings.count)
        return np.array(known.excess)[np.digitize(self.lateral, EDGES)]

    def error_at(self, parameters: Array, x: Array) -> Array:
        """(W, D) errors of the car with parameters (P,)."""
        y = predicted(self.superset.kernels, self.readings, parameters, x, self.substeps)
        error = self.pad(self._off(y))
        return self._without(~(np.abs(error).max(axis=1) < WILD), error)[0]

    def missed(self, space: Space, z: Array, x: Array) -> tuple[Array, bool]:
        """Errors (W, D) alone, the same numbers as `linear` gives, and whether all are finite."""
        y = predicted(
            self.superset.kernels, self.readings, space.chart.parameters(z), x, self.substeps
        )
        error = self.pad(self._off(y))
        return self._without(~(np.abs(error).max(axis=1) < WILD), error)


def pad_rows(readings: Readings) -> Padded:
    """Where the rows of each window lie."""
    if readings.slot is not None:
        return _pad_means(readings, readings.slot)
    row, there = _places(readings.layout.bounds)
    return Padded(row, there, there)


def _places(bounds: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """(W, D) numbers from each window's bounds, and where they are within them."""
    place = np.arange(int(np.diff(bounds).max()))[None, :]
    there = place < np.diff(bounds)[:, None]
    return np.where(there, bounds[:-1, None] + place, bounds[:-1, None]), there.astype(float)


def _pad_means(readings: Readings, slot: NDArray[np.int64]) -> Padded:
    """The same where rows of one slot are averaged; slots are numbered window after window."""
    _, first, member, counts = np.unique(
        slot, return_index=True, return_inverse=True, return_counts=True
    )
    window = np.searchsorted(readings.layout.bounds, first, side="right") - 1
    bounds = np.searchsorted(window, np.arange(readings.count + 1))
    place, there = _places(bounds)
    flat = np.flatnonzero(there.ravel() > 0.0)
    weights = csr_array(
        (1.0 / counts[member], (flat[member], np.arange(len(slot)))), shape=(there.size, len(slot))
    )
    return Padded(first[place], there, np.where(there > 0.0, counts[place], 1), weights)


def make_engine(superset: Superset, readings: Readings) -> Engine:
    """The windows as the superset is simulated over them."""
    return stepped_for(Engine(superset, readings, pad_rows(readings), 1), superset.base)


def stepped_for(engine: Engine, parameters: Array) -> Engine:
    """The engine with steps as short as a car (P,) needs, if its own are longer."""
    readings, car = engine.readings, model_of(engine.superset.kernels, parameters).car
    needed = stable_substeps(car, *readings.speeds, readings.layout.h, INTEGRATOR)
    return replace(engine, substeps=max(engine.substeps, needed))


def open_engine(
    superset: Superset,
    runs: Sequence[Run],
    horizon: float = HORIZON,
    most: float = np.inf,
    means: bool = False,
) -> Engine:
    """The windows of some drives; `horizon`, `most` and `means` as in `make_readings`.

    Raises:
        ValueError: the runs' grids differ, or no window sees enough poses.
    """
    late = float(superset.base[superset.kernels.names.index("pose_delay")])
    return make_engine(superset, make_readings(runs, late, speed_range(runs), horizon, most, means))


def take_windows(engine: Engine, chosen: NDArray[np.bool_]) -> Engine:
    """The engine on some of its windows (boolean mask (W,))."""
    layout, index = engine.readings.layout, np.flatnonzero(chosen)
    rows = np.concatenate([np.arange(layout.bounds[w], layout.bounds[w + 1]) for w in index])
    new_row = np.full(len(layout.values), -1)
    new_row[rows] = np.arange(len(rows))
    new_window = np.full(len(layout.spans), -1)
    new_window[index] = np.arange(len(index))
    kept = chosen[layout.seen.window]
    seen = layout.seen
    cut = replace(
        layout,
        spans=layout.spans[index], t=layout.t[index], run=layout.run[index],
        seen=type(seen)(
            new_window[seen.window[kept]], seen.t[kept], seen.kind[kept], new_row[seen.row[kept]]
        ),
        values=layout.values[rows], group=layout.group[rows],
        bounds=np.concatenate([[0], np.cumsum(np.diff(layout.bounds)[index])]),
        guess=layout.guess[index], has_past=layout.has_past[index],
    )  # fmt: skip
    readings = replace(
        engine.readings,
        layout=cut,
        t=engine.readings.t[rows],
        channel=engine.readings.channel[rows],
        slot=None if engine.readings.slot is None else engine.readings.slot[rows],
    )
    return replace(engine, readings=readings, padded=pad_rows(readings))


def decay_rate(car: Car[float], slowest: float, fastest: float) -> float:
    """Fastest decay of yaw rate and slip between two speeds [1/s].

    Below walking pace the tyre equations fade into the kinematic ones, so the rate stays bounded.
    """
    speeds = np.linspace(slowest, fastest, 32)
    share = np.asarray(dynamic_share(NUMPY, speeds), float)
    tyres = np.array([stiffness_rate(car, float(v)) for v in speeds])
    return float(np.max(share * tyres + (1.0 - share) * KINEMATIC_RATE))


def stable_substeps(
    car: Car[float], slowest: float, fastest: float, h: float, integrator: str = "rk4"
) -> int:
    """Integration steps that a step of `h` seconds needs for speeds in this range [m/s]."""
    rate = decay_rate(car, slowest, fastest)
    if not math.isfinite(rate):
        return SUBSTEPS_MAX
    return min(max(1, math.ceil(h * rate / DECAY_MAX[integrator])), SUBSTEPS_MAX)
