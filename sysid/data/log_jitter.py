"""The log's beat: commands that a recorder sampled late, now more and now less.

Many logs are written by a timer that stores the newest command of another timer. Both run at 10 Hz,
say, and not quite alike: a command waits in the recorder for anything between nothing and a whole
period, and the wait drifts like a saw. At 2 m/s, 0.1 s of doubt about a steer is 0.25 rad of
heading, more than all tyres have to say. Here the saw's phase and drift are found from the drive
itself, without a car: the path's curvature follows the steering, and where it leads or trails the
log is read window by window. Commands then take effect when they left, not when they were logged.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run, Signal, hold_means, pose_speed

Array = NDArray[np.float64]

PERIOD_LOW, PERIOD_HIGH = 0.04, 0.5
"""Faster logs have no beat worth the name, slower ones are no logs of steering [s]."""
DRIFT = 4e-3
"""Two timers of one nominal rate differ by less [s of wait per s]."""
SURE = 10.0
"""A saw must beat a constant wait by this log-likelihood."""
_CHANGES = 15
"""So many changes of the command tell its period."""
_WINDOW, _HOP = 1.2, 0.4
"""Length of a window and way to the next [s]."""
_PACE = 0.5
"""Slower cars' curvature is noise [m/s]."""
_REACH = 0.04
"""Curvature is read over so much time to either side [s]."""
_SERVO = 0.08
"""What servo and tyres lag about [s]; an error of it is the same in all windows."""
_SLACK = 0.15
"""The car may answer so much later than it is told [s]."""
_STEP = 0.005
"""Waits are tried in such steps [s]."""
_PHASE = 0.1
"""So far apart two saws may lie over a drive and hardly differ [periods]."""
_SAME = 0.1
"""Residuals so near hang together: they count once [s]."""


class Beat(NamedTuple):
    """How late a drive's steering was logged: `period (phase + drift t) mod period`.

    Attributes:
        run: the drive's name.
        period: of the log [s].
        phase: at the drive's first command, in periods.
        drift: how fast the phase moves [periods/s].
        sure: log-likelihood against a constant wait.
    """

    run: str
    period: float
    phase: float
    drift: float
    sure: float

    def wait(self, t: Array) -> Array:
        """How long commands logged at `t` had waited [s]."""
        waited: Array = self.period * np.mod(self.phase + self.drift * t, 1.0)
        return waited

    def describe(self) -> tuple[str, str]:
        """What was found, and what was done about it."""
        late, drift = 1e3 * self.period, 1e3 * abs(self.drift) * self.period
        found = f"{self.run}: steering stored 0 to {late:.0f} ms late"
        return found, f"(two timers drift apart by {drift:.1f} ms/s), undone"


def log_period(steer: Signal) -> float:
    """Period at which a steering log is refreshed [s]; 0 where it has none worth correcting."""
    changes = steer.t[1:][np.diff(steer.values) != 0.0]
    gaps = np.diff(changes)
    if len(gaps) < _CHANGES:
        return 0.0
    period = float(np.median(gaps[gaps < 1.5 * np.percentile(gaps, 10.0)]))
    off = np.abs(gaps / period - np.round(gaps / period))
    regular = float(np.mean(off < 0.15))
    return period if regular > 0.8 and PERIOD_LOW <= period <= PERIOD_HIGH else 0.0


def find_beat(run: Run) -> Beat | None:
    """The saw that explains when the car answered; None where there is none."""
    period = log_period(run.steer)
    if not period:
        return None
    waits = np.arange(-_SLACK, period + _STEP, _STEP)
    middles, loss = _losses(run, waits)
    if not len(middles):
        return None
    best = (np.inf, 0.0, 0.0)
    reach = DRIFT / period
    count = max(1, int(np.ceil(reach * run.duration / _PHASE)))
    offsets = np.arange(-_SLACK, 1e-9, 2.0 * _STEP)
    for drift in np.linspace(-reach, reach, 2 * count + 1).tolist():
        for phase in np.arange(0.0, 1.0, 0.5 * _PHASE).tolist():
            wait = Beat(run.name, period, phase, drift, 0.0).wait(middles)
            total = min(_along(loss, waits, wait + offset) for offset in offsets)
            best = min(best, (total, phase, drift))
    sure = float(loss.sum(axis=0).min()) - best[0]
    return Beat(run.name, period, best[1], best[2], sure) if sure > SURE else None


def _along(loss: Array, waits: Array, wait: Array) -> float:
    """Loss of windows (W,) whose waits are given, straight between those tried."""
    place = np.clip((wait - waits[0]) / _STEP, 0.0, len(waits) - 1.001)
    low = place.astype(int)
    part, rows = place - low, np.arange(len(wait))
    return float(((1.0 - part) * loss[rows, low] + part * loss[rows, low + 1]).sum())


def _losses(run: Run, waits: Array) -> tuple[Array, Array]:
    """Middles of windows (W,) [s], and their loss with the steering earlier by each wait (W, S)."""
    t, curvature, sound = _curvature(run)
    size, hop = round(_WINDOW / run.h), round(_HOP / run.h)
    starts = [
        a
        for a in range(0, len(t) - size, hop)
        if sound[a : a + size].all() and np.ptp(run.commands[a : a + size, 0]) > 0.0
    ]
    if not starts:
        return np.empty(0), np.empty((0, len(waits)))
    pick = np.array(starts)[:, None] + np.arange(size)
    y = curvature[pick]
    y = y - y.mean(axis=1, keepdims=True)
    left = np.array([_unexplained(y, _answer(run, t, float(wait))[pick]) for wait in waits]).T
    noise = np.maximum(np.median(left.min(axis=1)), 1e-12)
    counts = _HOP / _SAME  # windows overlap: each counts for its hop alone
    return t[pick].mean(axis=1), 0.5 * counts * np.log1p(left / noise)


def _unexplained(y: Array, x: Array) -> Array:
    """Mean square of `y` (W, N) that a straight line in `x` leaves (W,)."""
    x = x - x.mean(axis=1, keepdims=True)
    slope = np.sum(x * y, axis=1) / np.maximum(np.sum(x * x, axis=1), 1e-12)
    left: Array = np.mean((y - np.maximum(slope, 0.0)[:, None] * x) ** 2, axis=1)
    return left


def _answer(run: Run, t: Array, wait: float) -> Array:
    """The logged steering `wait` earlier, as a servo follows it."""
    edges: Array = np.append(t, t[-1] + run.h) + wait
    held = hold_means(run.steer, edges)
    kept = float(np.exp(-run.h / _SERVO))
    out, now = np.empty_like(held), float(held[0])
    for i, value in enumerate(held.tolist()):
        now = kept * now + (1.0 - kept) * value
        out[i] = now
    return out


def _curvature(run: Run) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Grid times, curvature of the path there [1/m], and whether the car moves and is seen."""
    grid: Array = (np.arange(len(run.commands)).astype(float) + 0.5) * run.h
    t, pose = run.pose
    times, speed = pose_speed(run.pose)
    if not len(times):
        return grid, np.zeros_like(grid), np.zeros(len(grid), bool)
    yaw = np.interp(np.stack([grid - _REACH, grid + _REACH]), t, pose[:, 2])
    forward = np.interp(grid, times, speed)
    near = np.abs(grid - t[np.clip(np.searchsorted(t, grid), 0, len(t) - 1)]) < _REACH
    sound = near & (forward > _PACE)
    rate = (yaw[1] - yaw[0]) / (2.0 * _REACH)
    return grid, rate / np.maximum(forward, _PACE), sound


def undo_beat(run: Run, beat: Beat) -> Run:
    """The drive with its steering when it left, not when it was logged."""
    t, values = run.steer
    changed = np.concatenate([[True], np.diff(values) != 0.0])
    moved = t[changed] - beat.wait(t[changed])
    moved[0] = t[0]
    steer = Signal(np.maximum.accumulate(moved), values[changed])
    edges: Array = np.arange(len(run.commands) + 1).astype(float) * run.h
    commands = np.column_stack([hold_means(steer, edges), run.commands[:, 1]])
    return replace(run, commands=commands, steer=steer, beat=beat)


def steadied(run: Run) -> Run:
    """The drive as it was driven: a log's beat is undone, if it has one."""
    beat = None if run.servo_frame else find_beat(run)
    return undo_beat(run, beat) if beat else run
