"""Validation on drives that were not fitted: how far off a prediction is after 0.5, 1 and 2 s.

Open loop: the model is brought to the state at which it explains the moment before best, and
then predicts from the commands alone.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from steerd.car_model.model import Model
from steerd.car_model.native import windows as compiled
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import Layout, estimate_noise, make_layout, make_stations
from steerd.sysid.inference.augmented_car import prescribe_speed
from steerd.sysid.inference.predictor import STATE_SPREAD, stable_substeps

HORIZONS: tuple[float, ...] = (0.5, 1.0, 2.0)  # [s]
PAST = 0.4  # measurements that show the state at which a prediction starts [s]
_ROUNDS = 8
_FLOORS = np.array([3e-3, 5e-3, 0.02, 0.05])
"""A start is not known better than this [m, rad, m/s, rad/s]: no model is that good."""
_ROOM = 1.15  # windows are cut this much longer: drives do not divide evenly
_NEAR = 0.05  # poses this close to a horizon count for it [s]
_STATES = 7
LATERAL: tuple[float, ...] = (0.0, 2.0, 4.0, 6.0, np.inf)
"""Edges of the classes of lateral acceleration [m/s^2]: rolling, lively, hard, at the limit."""
_STEADY = 0.2  # a lateral acceleration is read over so much time [s]


class Prediction(NamedTuple):
    """Prediction error at one horizon."""

    horizon: float  # [s]
    position: float  # RMS distance [m]; NaN where no window reached so far
    median: float  # of the distances [m]: one spin does not decide it
    heading: float  # RMS angle [rad]


class Trace(NamedTuple):
    """Measured and predicted poses of one window, for looking at."""

    ahead: Array  # (M,) time since the prediction's start [s]
    measured: Array  # (M, 3) poses; predicted: (M, 3) poses
    predicted: Array


def trace_windows(model: Model[float], runs: Sequence[Run], horizon: float) -> list[Trace]:
    """Predict windows of drives, each over a horizon [s]; without speed commands at measured speed.

    Raises:
        ValueError: no window sees enough poses.
    """
    model = prescribe_speed(model, runs)
    kernels = compiled.make_kernels(model.effects, model.chassis)
    parameters = compiled.parameter_vector(model)
    late = float(compiled.delays_of(kernels, parameters)[2])
    layout = make_layout(runs, _ROOM * (PAST + horizon), late)
    speeds = layout.window_speeds
    substeps = stable_substeps(model.car, speeds.min(), speeds.max(), layout.h)
    held = compiled.HeldCommands(layout.commands, layout.h, substeps)
    stations, windows = make_stations(layout, late, held.fine), layout.kernel_windows(substeps)
    seeds, dfirst = np.zeros((len(parameters), _STATES)), np.eye(_STATES)

    def look(x: Array) -> tuple[Array, Array]:
        return compiled.compute_readings(
            kernels, parameters, seeds, x, dfirst, held, windows, stations
        )

    sigma = np.maximum(estimate_noise(runs), _FLOORS)
    y, seen, found = look(_settle(layout, sigma, look))[0], layout.seen, []
    for w in range(len(layout.spans)):
        mine = (seen.window == w) & (seen.kind == 0)
        rows = seen.row[mine][:, None] + np.arange(3)
        found.append(Trace(seen.t[mine] - PAST, layout.values[rows], y[rows]))
    return found


def _settle(layout: Layout, sigma: Array, look: Callable[[Array], tuple[Array, Array]]) -> Array:
    """Initial states (W, 7) that explain the past best: damped Gauss-Newton, window by window."""
    best, share = layout.guess.copy(), np.ones(len(layout.spans))
    lowest, step = np.full(len(best), np.inf), np.zeros_like(best)
    for _ in range(_ROUNDS):
        x = best + share[:, None] * step
        cost, new = _correct(layout, sigma, x, *look(x))
        better = cost < lowest
        best[better], step[better], lowest[better] = x[better], new[better], cost[better]
        share = np.where(better, 1.0, 0.3 * share)
    return best


def _angles(error: Array) -> Array:
    return np.asarray((error + np.pi) % (2.0 * np.pi) - np.pi)


def _correct(layout: Layout, sigma: Array, x: Array, y: Array, jy: Array) -> tuple[Array, Array]:
    """Cost of initial states on the past alone (W,), and the Gauss-Newton step from them (W, 7)."""
    early = (layout.row_t <= PAST).astype(float)  # rows that show the start
    weight = early / sigma[layout.group]
    error = layout.values - y
    error[layout.group == 1] = _angles(error[layout.group == 1])
    error, slopes = error * weight, jy * weight[:, None]
    cost, step = np.full(len(x), np.inf), np.zeros_like(x)
    for w in range(len(x)):
        a, b = layout.bounds[w], layout.bounds[w + 1]
        if not (np.isfinite(error[a:b]).all() and np.isfinite(slopes[a:b]).all()):
            continue
        off = (layout.guess[w] - x[w]) / STATE_SPREAD
        cost[w] = error[a:b] @ error[a:b] + off @ off
        square = slopes[a:b].T @ slopes[a:b] + np.diag(STATE_SPREAD**-2)
        step[w] = np.linalg.solve(square, slopes[a:b].T @ error[a:b] + off / STATE_SPREAD)
    return cost, step


def errors_at(traces: Sequence[Trace], horizons: Sequence[float]) -> tuple[Prediction, ...]:
    """Errors of predictions at horizons."""
    ahead = np.concatenate([trace.ahead for trace in traces])
    off = np.concatenate([trace.measured - trace.predicted for trace in traces])
    out = []
    for horizon in horizons:
        near = np.abs(ahead - horizon) <= _NEAR
        if not near.any():
            out.append(Prediction(horizon, np.nan, np.nan, np.nan))
            continue
        distance, angle = np.hypot(*off[near, :2].T), _angles(off[near, 2])
        position, heading = (float(np.sqrt(np.mean(e**2))) for e in (distance, angle))
        out.append(Prediction(horizon, position, float(np.median(distance)), heading))
    return tuple(out)


class Regime(NamedTuple):
    """Prediction error where the car was driven within some range of lateral acceleration."""

    lateral_accel_low: float  # of the greatest lateral acceleration on the way [m/s^2]
    lateral_accel_high: float
    predictions: int  # how many
    median: float  # of the position error at the horizon [m]; rms: as well
    rms: float


def by_lateral_acceleration(traces: Sequence[Trace], horizon: float) -> tuple[Regime, ...]:
    """Where a car predicts well and where not: errors at a horizon by how hard it was driven."""
    found = [(_lateral(trace, horizon), _off_at(trace, horizon)) for trace in traces]
    lateral, off = np.array(found).reshape(-1, 2).T
    regimes = []
    for low, high in pairwise(LATERAL):
        mine = off[(lateral >= low) & (lateral < high) & np.isfinite(off)]
        if len(mine):
            median, rms = float(np.median(mine)), float(np.sqrt(np.mean(mine**2)))
            regimes.append(Regime(low, high, len(mine), median, rms))
    return tuple(regimes)


def _off_at(trace: Trace, horizon: float) -> float:
    """Position error at a horizon [m]; NaN where no pose is near it."""
    i = int(np.argmin(np.abs(trace.ahead - horizon)))
    if abs(trace.ahead[i] - horizon) > _NEAR:
        return float("nan")
    return float(np.hypot(*(trace.measured[i, :2] - trace.predicted[i, :2])))


def _lateral(trace: Trace, horizon: float) -> float:
    """Greatest lateral acceleration up to a horizon [m/s^2], from the measured poses."""
    near = (trace.ahead >= -1e-9) & (trace.ahead <= horizon)
    t, pose = trace.ahead[near], trace.measured[near]
    if len(t) < 2 or t[-1] - t[0] < _STEADY:
        return 0.0
    edges = np.arange(t[0], t[-1] + 1e-9, _STEADY)
    x, y, yaw = (np.interp(edges, t, pose[:, i]) for i in range(3))
    turned = np.abs(_angles(np.diff(yaw)))
    return float((np.hypot(np.diff(x), np.diff(y)) * turned).max() / _STEADY**2)
