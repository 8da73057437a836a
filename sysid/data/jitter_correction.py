"""Corrects the sampling jitter of steering logs.

Many logs are written by a timer that stores the newest command of another timer. Both run at about
10 Hz, but not at exactly the same rate: a command waits in the recorder for up to one period, and
the wait changes as a sawtooth. At 2 m/s, 0.1 s of steering delay is 0.25 rad of heading: more than
any tyre effect. The sawtooth's phase and drift are found without a vehicle model: the path's
curvature follows the steering, and windows show by how much the log leads or trails.
"""

from dataclasses import replace
from itertools import accumulate

import numpy as np

from steerd.sysid.data.data_checks import Array, Mask
from steerd.sysid.data.dataset import LogJitter, Run, Signal, hold_means, pose_rates

PERIOD_LOW, PERIOD_HIGH = 0.04, 0.5
"""Jitter of faster logs is negligible; slower logs are not steering commands [s]."""
DRIFT_MAX = 4e-3  # two timers of one nominal rate differ by less [s of delay per s]
LOG_LIKELIHOOD_MIN = 10.0  # a sawtooth must gain this over a constant delay [nats]
_CHANGES_MIN = 15  # changes of the command that the period is estimated from, at least
_WINDOW, _HOP = 1.2, 0.4  # length of a window and distance between the starts of two [s]
_SPEED_MIN = 0.5  # at lower speed the curvature is noise [m/s]
_HALF_SPAN = 0.04  # curvature is a difference over this time to either side [s]
_SERVO_LAG = 0.08  # typical lag of servo and tyres [s]; an error of it is the same in all windows
_RESPONSE_MAX = 0.15  # the car may respond this much after the log at most [s]
_STEP = 0.005  # grid of the delays that are tried [s]
_PHASE_STEP = 0.1  # two sawtooths whose phases differ by this are alike [periods]
_CORRELATED = 0.1  # residuals within this time are correlated and count once [s]


def log_period(steer: Signal) -> float:
    """Period at which a steering log is refreshed [s]; 0 where it has none worth correcting."""
    changes = steer.t[1:][np.diff(steer.values) != 0.0]
    gaps = np.diff(changes)
    if len(gaps) < _CHANGES_MIN:
        return 0.0
    period = float(np.median(gaps[gaps < 1.5 * np.percentile(gaps, 10.0)]))
    regular = float(np.mean(np.abs(gaps / period - np.round(gaps / period)) < 0.15))
    return period if regular > 0.8 and PERIOD_LOW <= period <= PERIOD_HIGH else 0.0


def find_log_jitter(run: Run) -> LogJitter | None:
    """The sawtooth delay that explains the car's response; None where there is none."""
    period = log_period(run.steer)
    if not period:
        return None
    delays = np.arange(-_RESPONSE_MAX, period + _STEP, _STEP)
    centres, loss = _losses(run, delays)
    if not len(centres):
        return None
    best = (np.inf, 0.0, 0.0)
    drift_max = DRIFT_MAX / period
    count = max(1, int(np.ceil(drift_max * run.duration / _PHASE_STEP)))
    offsets = np.arange(-_RESPONSE_MAX, 1e-9, 2.0 * _STEP)
    for drift in np.linspace(-drift_max, drift_max, 2 * count + 1).tolist():
        for phase in np.arange(0.0, 1.0, 0.5 * _PHASE_STEP).tolist():
            delay = LogJitter(run.name, period, phase, drift).delay(centres)
            total = min(_interpolated_loss(loss, delays, delay + offset) for offset in offsets)
            best = min(best, (total, phase, drift))
    gain = float(loss.sum(axis=0).min()) - best[0]
    return LogJitter(run.name, period, *best[1:]) if gain > LOG_LIKELIHOOD_MIN else None


def _interpolated_loss(loss: Array, delays: Array, delay: Array) -> float:
    """Loss of windows (W,) at given delays, interpolated linearly between those tried."""
    place = np.clip((delay - delays[0]) / _STEP, 0.0, len(delays) - 1.001)
    low = place.astype(int)
    part, rows = place - low, np.arange(len(delay))
    return float(((1.0 - part) * loss[rows, low] + part * loss[rows, low + 1]).sum())


def _losses(run: Run, delays: Array) -> tuple[Array, Array]:
    """Window centres (W,) [s], and their loss (W, S) with the steering earlier by each delay."""
    t, curvature, valid = _curvature(run)
    size, hop = round(_WINDOW / run.h), round(_HOP / run.h)
    pick = np.arange(0, len(t) - size, hop)[:, None] + np.arange(size)
    pick = pick[valid[pick].all(axis=1) & (np.ptp(run.commands[pick, 0], axis=1) > 0.0)]
    if not len(pick):
        return np.empty(0), np.empty((0, len(delays)))
    y = curvature[pick]
    y = y - y.mean(axis=1, keepdims=True)
    left = []  # mean square residual of a regression on the steering with a slope of 0 or more
    for delay in delays:
        x = _response(run, t, float(delay))[pick]
        x = x - x.mean(axis=1, keepdims=True)
        slope = np.sum(x * y, axis=1) / np.maximum(np.sum(x * x, axis=1), 1e-12)
        left.append(np.mean((y - np.maximum(slope, 0.0)[:, None] * x) ** 2, axis=1))
    unexplained = np.array(left).T
    noise = np.maximum(np.median(unexplained.min(axis=1)), 1e-12)
    counts = _HOP / _CORRELATED  # windows overlap: each counts for its hop only
    return t[pick].mean(axis=1), 0.5 * counts * np.log1p(unexplained / noise)


def _response(run: Run, t: Array, delay: float) -> Array:
    """The logged steering `delay` earlier, through the servo's first-order lag."""
    edges: Array = np.append(t, t[-1] + run.h) + delay
    kept = float(np.exp(-run.h / _SERVO_LAG))
    held = hold_means(run.steer, edges).tolist()
    return np.array([*accumulate(held, lambda angle, aim: aim + kept * (angle - aim))])


def _curvature(run: Run) -> tuple[Array, Array, Mask]:
    """Grid times, curvature of the path [1/m], and whether the car moves and poses are near."""
    grid: Array = (np.arange(len(run.commands)).astype(float) + 0.5) * run.h
    t, pose = run.pose
    times, speed, _ = pose_rates(run.pose)
    if not len(times):
        return grid, np.zeros_like(grid), np.zeros(len(grid), bool)
    yaw = np.interp(np.stack([grid - _HALF_SPAN, grid + _HALF_SPAN]), t, pose[:, 2])
    forward = np.interp(grid, times, speed)
    near = np.abs(grid - t[np.clip(np.searchsorted(t, grid), 0, len(t) - 1)]) < _HALF_SPAN
    valid = near & (forward > _SPEED_MIN)
    rate = (yaw[1] - yaw[0]) / (2.0 * _HALF_SPAN)
    return grid, rate / np.maximum(forward, _SPEED_MIN), valid


def correct_log_jitter(run: Run) -> Run:
    """The drive with its steering at the times at which it was sent, if its log has jitter."""
    jitter = None if run.servo_frame else find_log_jitter(run)
    if jitter is None:
        return run
    t, values = run.steer
    changed = np.concatenate([[True], np.diff(values) != 0.0])
    moved = t[changed] - jitter.delay(t[changed])
    moved[0] = t[0]
    steer = Signal(np.maximum.accumulate(moved), values[changed])
    commands = np.column_stack([hold_means(steer, run.edges), run.commands[:, 1]])
    return replace(run, commands=commands, steer=steer, log_jitter=jitter)
