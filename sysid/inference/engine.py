"""The prediction error of windows: whitened, with each window's start eliminated.

Unknown are the coordinates `z` (n,) of a hypothesis and each window's start `x` (W, 7). The start
is eliminated by variable projection; the whitening holds everything random: the instruments' noise
and what disturbs the car on its way (`noise`).
"""

# Why: docs/decisions/diagnosis.md#d51

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.native.windows import (
    HeldCommands,
    Stations,
    compute_readings,
    delays_of,
    model_of,
)
from steerd.sysid.estimation.objective import STATE_SPREAD, STATES, STEER_SPREAD_UNKNOWN
from steerd.sysid.estimation.stability import stable_substeps
from steerd.sysid.inference.knowledge import EDGES
from steerd.sysid.inference.readings import Readings
from steerd.sysid.inference.space import Space
from steerd.sysid.inference.superset import Superset
from steerd.sysid.inference.values import INTEGRATOR, predicted

Array = NDArray[np.float64]

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


class Padded(NamedTuple):
    """Rows by window: `row` (W, D) place among all rows, `there` (W, D) 1 where there is one."""

    row: NDArray[np.int64]
    there: Array


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


class Tangent(NamedTuple):
    """Whitened derivatives about one point, with the starts' part solved.

    Attributes:
        by_z: (W, D, n) whitened.
        by_x: (W, D, 7) whitened.
        inverse: (W, 7, 7) inverse curvature of the starts, priors included.
        cross: (W, 7, n).
        kx: (W, 7, n) starts' step per coordinate's.
        h: (W, n, n) curvature with the starts eliminated.
    """

    by_z: Array
    by_x: Array
    inverse: Array
    cross: Array
    kx: Array
    h: Array

    def holding(self, held: NDArray[np.bool_]) -> "Tangent":
        """The same with the starts of some windows (mask (W,)) where they are."""
        free = ~held[:, None, None]
        whole = self.by_z.transpose(0, 2, 1) @ self.by_z
        return self._replace(
            inverse=self.inverse * free, cross=self.cross * free, kx=self.kx * free,
            h=np.where(free, self.h, whole),
        )  # fmt: skip


class Reduced(NamedTuple):
    """Windows' losses as functions of the coordinates alone, about one point.

    Attributes:
        square: (W,) whitened squared error, the start's prior included, at its best start.
        dof: (W,) measurements of each window.
        g: (W, n) Gauss-Newton gradient of half the square (minus: where the square falls).
        h: (W, n, n) its curvature.
        dx: (W, 7) step of the start; minus `kx` (W, 7, n) per step of the coordinates.
        kx: see `dx`.
        finite: whether the simulation stayed finite.
        limit: squared error per degree of freedom from which a window is lost: a car that spins
            is chaotic, and its derivatives point nowhere.
    """

    square: Array
    dof: Array
    g: Array
    h: Array
    dx: Array
    kx: Array
    finite: bool
    limit: float = np.inf

    @property
    def weight(self) -> Array:
        """(W,) weight of each window: those that nothing explains pull less, lost ones not."""
        ratio = self.square / self.dof
        weight: Array = np.where(ratio < self.limit, 2.0 / (1.0 + ratio), 0.0)
        return weight

    @property
    def loss(self) -> Array:
        """(W,) negative log-likelihood [nats] under Student's t of as many degrees as rows."""
        loss: Array = self.dof * np.log1p(np.minimum(self.square / self.dof, self.limit))
        return loss


@dataclass(frozen=True, eq=False)
class Engine:
    """Windows of a session seen by the superset of all effects.

    Attributes:
        superset: the car.
        readings: the windows.
        padded: rows by window.
        whiten: (W, D, D) inverse square root of each window's noise covariance.
        substeps: integration steps to a command.
    """

    superset: Superset
    readings: Readings
    padded: Padded
    whiten: Array
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
        there = self.padded.there
        shaped = there.reshape(there.shape + (1,) * (rows.ndim - 1))
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

    def reduce(self, space: Space, z: Array, x: Array) -> Reduced:
        """Losses at coordinates `z`, with the starts eliminated about `x`."""
        return self.eliminate(self.linear(space, z, x), x)

    def eliminate(self, at: Linear, x: Array) -> Reduced:
        """The starts taken out of whitened errors."""
        if not at.finite:
            return self.lost(at.by_z.shape[2])
        return self.reduce_by(self.tangent(at), at.error, x)

    def tangent(self, at: Linear) -> Tangent:
        """Whitened derivatives of a point, ready for any errors near it."""
        by_z, by_x = self.whiten @ at.by_z, self.whiten @ at.by_x
        turned = by_x.transpose(0, 2, 1)
        d = turned @ by_x
        d[:, range(STATES), range(STATES)] += self.start_spread**-2
        inverse: Array = np.linalg.inv(d).astype(float)
        cross = turned @ by_z
        kx = inverse @ cross
        h = by_z.transpose(0, 2, 1) @ by_z - cross.transpose(0, 2, 1) @ kx
        return Tangent(by_z, by_x, inverse, cross, kx, h)

    def reduce_by(self, tangent: Tangent, error: Array, x: Array) -> Reduced:
        """Losses for errors (W, D) at starts `x`, with derivatives that may be of a near point."""
        white = np.matmul(self.whiten, error[:, :, None])[:, :, 0]
        spread = self.start_spread
        away = (self.readings.layout.guess - x) / spread
        pull = np.matmul(white[:, None, :], tangent.by_x)[:, 0] + away / spread
        dx = np.matmul(tangent.inverse, pull[:, :, None])[:, :, 0]
        square = (white**2).sum(axis=1) + (away**2).sum(axis=1) - (pull * dx).sum(axis=1)
        g = np.matmul(white[:, None, :], tangent.by_z)[:, 0]
        g = g - np.matmul(dx[:, None, :], tangent.cross)[:, 0]
        dof = self.padded.there.sum(axis=1) - FREE_STATES
        return Reduced(np.maximum(square, 0.0), dof, g, tangent.h, dx, tangent.kx, True)

    def square_at(self, error: Array, x: Array) -> Array:
        """(W,) whitened squared errors (W, D) and starts (W, 7) as they are, priors included."""
        white = np.matmul(self.whiten, error[:, :, None])[:, :, 0]
        away = (self.readings.layout.guess - x) / self.start_spread
        square: Array = (white**2).sum(axis=1) + (away**2).sum(axis=1)
        return square

    def lost(self, n: int) -> Reduced:
        """What a simulation that left the map counts as."""
        count = self.readings.count
        nothing = np.zeros((count, STATES))
        return Reduced(
            np.full(count, np.inf), self.padded.there.sum(axis=1) - FREE_STATES,
            np.zeros((count, n)), np.zeros((count, n, n)), nothing,
            np.zeros((count, STATES, n)), False,
        )  # fmt: skip


def pad_rows(readings: Readings) -> Padded:
    """Where the rows of each window lie."""
    bounds = readings.layout.bounds
    width = int(np.diff(bounds).max())
    place = np.arange(width)[None, :]
    there = place < np.diff(bounds)[:, None]
    index = np.where(there, bounds[:-1, None] + place, bounds[:-1, None])
    return Padded(index, there.astype(float))


def make_engine(superset: Superset, readings: Readings, sigma: Array) -> Engine:
    """An engine that knows the instruments' noise alone: `sigma` (4,) by `windows.GROUPS`."""
    padded = pad_rows(readings)
    per_row = (1.0 / sigma)[readings.layout.group][padded.row] * padded.there
    white = per_row[:, :, None] * np.eye(padded.there.shape[1])
    car = model_of(superset.kernels, superset.base).car
    substeps = stable_substeps(car, *readings.speeds, readings.layout.h, INTEGRATOR)
    return Engine(superset, readings, padded, white, substeps)


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
    )
    padded = pad_rows(readings)
    width = padded.there.shape[1]
    return replace(
        engine, readings=readings, padded=padded, whiten=engine.whiten[index][:, :width, :width]
    )
