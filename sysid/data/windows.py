"""Windows of drives: what is simulated from where, and which measurements it is compared with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.native.windows import Stations, Windows
from steerd.sysid.data.data_checks import Array, Indices, Mask, noise_of
from steerd.sysid.data.dataset import HISTORY, Run, Signal

GROUPS: tuple[str, ...] = ("position", "yaw", "wheel_speed", "yaw_rate")
"""Measurements that share a noise level: [m], [rad], [m/s], [rad/s]."""
FLOORS = np.array([1e-5, 1e-5, 1e-4, 1e-4])
"""Noise levels are at least this; simulated instruments may have none."""
POSES_MIN = 4  # a window with fewer poses is left out (its initial state would not be identifiable)
SPACING = 0.05  # time between readings where they are thinned [s]
_WINDOWS_MIN = 4
_GUESS_SPAN = 0.12  # poses within this time of a window's start give the first guess of it [s]
_CHANNELS = np.array([0, 3, 4])  # first channel of each kind of reading
_FORGOTTEN = 0.2  # commands that move so far leave no play as it was; none is wider than 0.15 [rad]


class Seen(NamedTuple):
    """Readings at stations, sorted by window: a pose has three rows, the others one."""

    window: Indices  # which; t: time since its start [s]; kind: 0 pose, 1 wheel speed, 2 yaw rate
    t: Array
    kind: Indices
    row: Indices  # first row of the reading


@dataclass(frozen=True, eq=False)
class Layout:
    """Windows of several runs and their measurements."""

    h: float  # step of the commands [s]
    commands: Array  # (rows, 2) of all runs, one after the other
    spans: Indices  # (W, 5) as `kernels.Windows.spans`, in steps of `h`
    t: Array  # (W,) time into the drive [s]
    run: Indices  # (W,) which run
    seen: Seen  # what is compared
    values: Array  # (R,) measurements
    bounds: Indices  # (W + 1,) rows of each window
    guess: Array  # (W, 7) first guess of the initial states, from the poses alone; steer 0

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.spans)

    @cached_property
    def reading(self) -> Indices:
        """(R,) of which reading each row is."""
        return np.repeat(np.arange(len(self.seen.row)), _width(self.seen.kind))

    @cached_property
    def row_t(self) -> Array:
        """(R,) time of each row since its window's start [s]."""
        return np.asarray(self.seen.t[self.reading])

    @cached_property
    def channel(self) -> Indices:
        """(R,) 0 x, 1 y, 2 yaw, 3 wheel speed, 4 yaw rate."""
        first = _CHANNELS[self.seen.kind] - self.seen.row
        return np.asarray(first[self.reading] + np.arange(len(self.values)))

    @property
    def window(self) -> Indices:
        """(R,) which window."""
        return np.repeat(np.arange(self.count), np.diff(self.bounds))

    @property
    def window_speeds(self) -> Array:
        """(W, 2) slowest and fastest speed of each window, from commands and its start [m/s]."""
        past, out = round(HISTORY / self.h), np.empty((self.count, 2))
        for w, (low, _, first, steps, _) in enumerate(self.spans.tolist()):
            ordered = self.commands[max(low, first - past) : first + steps, 1]
            speeds = np.abs(np.append(ordered, self.guess[w, 3]))
            out[w] = speeds.min(), speeds.max()
        return out

    @property
    def group(self) -> Indices:
        """(R,) which noise level, see `GROUPS`."""
        return np.maximum(self.channel - 1, 0)

    @property
    def has_past(self) -> Mask:
        """(W,) whether the commands before the window are known."""
        past = self.spans[:, 2] - self.spans[:, 0]
        return np.asarray(past >= round(HISTORY / self.h) // 2)

    def rows(self, window: int) -> slice:
        """Rows of a window."""
        return slice(int(self.bounds[window]), int(self.bounds[window + 1]))

    def kernel_windows(self, substeps: int) -> Windows:
        """The windows in integration steps."""
        return Windows(self.spans * np.array([1, 1, 1, substeps, substeps]), self.t)


@lru_cache(maxsize=16)
def make_stations(layout: Layout, pose_delay: float, step: float) -> Stations:
    """Where to read, when poses are `pose_delay` late and steps are `step` long [s]."""
    seen = layout.seen
    true = (seen.t - np.where(seen.kind == 0, pose_delay, 0.0)) / step
    k = np.floor(true).astype(np.int64)
    order = np.lexsort((true, seen.window))
    places = np.column_stack([k, _CHANNELS[seen.kind], seen.row, seen.kind == 0])[order]
    spans = np.searchsorted(seen.window, np.arange(len(layout.spans) + 1))
    return Stations(np.ascontiguousarray(places), (true - k)[order], spans, len(layout.values))


def guess_state(pose: Signal, t: float) -> Array:
    """State at time `t` from a quadratic through the poses about it; steer 0."""
    near = np.flatnonzero(np.abs(pose.t - t) <= _GUESS_SPAN)
    if len(near) < 6:
        near = np.sort(np.argsort(np.abs(pose.t - t))[:6])
    at = pose.t[near] - t
    basis = np.column_stack([np.ones_like(at), at, at * at])
    fit = np.linalg.lstsq(basis, pose.values[near], rcond=None)[0]
    (x, y, yaw), (vx, vy, rate) = fit[0], fit[1]
    forward = vx * np.cos(yaw) + vy * np.sin(yaw)
    aside = -vx * np.sin(yaw) + vy * np.cos(yaw)
    slip = float(np.clip(np.arctan2(aside, forward), -0.3, 0.3)) if forward > 0.3 else 0.0
    return np.array([x, y, yaw, np.copysign(np.hypot(vx, vy), forward), rate, slip, 0.0])


def _edges(run: Run, horizon: float, pose_delay: float) -> Indices:
    """Grid indices at which windows of about `horizon` seconds begin and end."""
    first = max(0.0, run.pose.t[0] - pose_delay)
    last = min(run.duration, run.pose.t[-1] - pose_delay)
    low, high = int(np.ceil(first / run.h - 1e-9)), int(np.floor(last / run.h + 1e-9))
    count = max(1, round((high - low) * run.h / horizon))
    return np.unique(np.linspace(low, high, count + 1).round().astype(np.int64))


def remembered(steering: Array, a: int, least: int, most: int) -> int:
    """Steps before a window at `a` of which a linkage may remember something.

    Play remembers no more than when the command last moved by the whole gap; `least` steps before
    that are what lag and slew limit remember. Doubled from `least` on, so that many windows are
    alike and are simulated side by side.
    """
    past = steering[max(0, a - most) : a + 1][::-1]
    moved = np.maximum.accumulate(past) - np.minimum.accumulate(past)
    needed = int(np.searchsorted(moved, _FORGOTTEN)) + least
    steps = least
    while steps < min(needed, most):
        steps *= 2
    return min(steps, most)


def _cut(run: Run, horizon: float, pose_delay: float) -> tuple[NDArray[Any], ...]:
    """A run's windows (W, 5), as `Layout.spans` of it alone, and what is read in them.

    Of each reading its window, time and kind; then the measurements of all.
    """
    edges = _edges(run, horizon, pose_delay)
    least, most = round(HISTORY / run.h), round(run.history / run.h)
    settle = [
        max(least, min(remembered(run.commands[:, 0], a, least, most), a))
        for a in edges[:-1].tolist()
    ]
    whole = np.tile([0, len(run.commands)], (len(settle), 1))
    spans = np.column_stack([whole, edges[:-1], np.diff(edges), np.array(settle, np.int64)])
    limits = edges * run.h
    limits[-1] += 1e-9
    signals = {0: run.pose, 1: run.wheel, 2: run.yaw_rate}
    if run.speed_source != "command":
        del signals[1]
    readings = []
    for kind, (t, values) in signals.items():
        late = 0.0 if kind else pose_delay
        window = np.searchsorted(limits + late, t, side="right") - 1
        inside = (window >= 0) & (window < len(spans))
        window = window[inside]
        since = t[inside] - (limits + late)[window] + late
        readings.append((window, since, np.full(len(window), kind), values[inside].ravel()))
    return spans, *(np.concatenate(each) for each in zip(*readings, strict=True))


def make_layout(
    runs: Sequence[Run], horizon: float, pose_delay: float = 0.0, most: float = np.inf
) -> Layout:
    """Split runs on one grid into windows of about `horizon` seconds; whole runs when it is longer.

    Poses are known to be `pose_delay` late [s]. The windows last for `most` [s] in all, evenly from
    the whole.

    Raises:
        ValueError: the runs' grids differ, or no window has enough poses.
    """
    if len({run.h for run in runs}) != 1:
        raise ValueError("runs must share one grid step")
    h, cuts = runs[0].h, [_cut(run, horizon, pose_delay) for run in runs]
    counts, readings = [len(cut[0]) for cut in cuts], [len(cut[1]) for cut in cuts]
    spans, window, at, kind, values = (np.concatenate(each) for each in zip(*cuts, strict=True))
    number = np.repeat(np.arange(len(runs)), counts)
    low = np.cumsum([0, *(len(run.commands) for run in runs)])[number]
    window = window + np.repeat(np.cumsum([0, *counts[:-1]]), readings)
    layout = Layout(
        h=h,
        commands=np.concatenate([run.commands for run in runs]),
        spans=spans + np.outer(low, [1, 1, 1, 0, 0]),
        t=np.array([run.start for run in runs])[number] + spans[:, 2] * h,
        run=number,
        seen=Seen(window, at, kind, np.cumsum(_width(kind)) - _width(kind)),
        values=values,
        bounds=np.empty(0, np.int64),
        guess=np.empty((len(spans), 7)),
    )
    layout = take_readings(layout, np.lexsort((kind, window)))
    chosen = np.flatnonzero(np.bincount(window[kind == 0], minlength=len(spans)) >= POSES_MIN)
    if not len(chosen):
        raise ValueError(f"no window of {horizon:g} s sees {POSES_MIN} poses")
    if np.isfinite(most):
        length = h * float(np.mean(spans[chosen, 3]))
        count = min(len(chosen), max(_WINDOWS_MIN, round(most / length)))
        chosen = chosen[np.linspace(0, len(chosen) - 1, count).round().astype(int)]
    begin = spans[chosen, 2] * h + pose_delay
    poses = [runs[i].pose for i in number[chosen]]
    guess = np.array([guess_state(*each) for each in zip(poses, begin.tolist(), strict=True)])
    return replace(take_windows(layout, np.isin(np.arange(len(spans)), chosen)), guess=guess)


def _width(kind: Indices) -> Indices:
    """Rows of readings of these kinds."""
    return np.where(kind == 0, 3, 1)


def thinned(layout: Layout, spacing: float = SPACING) -> Layout:
    """Of each window's and instrument's readings, the one nearest to each multiple of `spacing`.

    Denser readings add nothing but rows: what is not noise of the instrument is correlated over far
    longer times.
    """
    seen = layout.seen
    slot = np.round(seen.t / spacing).astype(np.int64)
    order = np.lexsort((np.abs(seen.t - spacing * slot), slot, seen.kind, seen.window))
    key = np.column_stack([seen.window, seen.kind, slot])[order]
    first = np.append(True, (key[1:] != key[:-1]).any(axis=1))
    kept = np.zeros(len(order), bool)
    kept[order[first]] = True
    return take_readings(layout, kept)


def take_readings(layout: Layout, kept: Mask | Indices) -> Layout:
    """The layout with some of its readings (mask or places in `seen`, sorted by window)."""
    window, kind = layout.seen.window[kept], layout.seen.kind[kept]
    width = _width(kind)
    first = np.cumsum(width) - width
    rows = np.repeat(layout.seen.row[kept] - first, width) + np.arange(width.sum())
    bounds = np.searchsorted(np.repeat(window, width), np.arange(layout.count + 1))
    seen = Seen(window, layout.seen.t[kept], kind, first)
    return replace(layout, seen=seen, values=layout.values[rows], bounds=bounds)


def take_windows(layout: Layout, chosen: Mask) -> Layout:
    """The layout of some of its windows (mask (W,))."""
    cut = take_readings(layout, chosen[layout.seen.window])
    window = (np.cumsum(chosen) - 1)[cut.seen.window]
    return replace(
        cut, spans=cut.spans[chosen], t=cut.t[chosen], run=cut.run[chosen],
        seen=cut.seen._replace(window=window), guess=cut.guess[chosen],
        bounds=np.append(0, np.cumsum(np.diff(layout.bounds)[chosen])),
    )  # fmt: skip


def estimate_noise(runs: Sequence[Run]) -> Array:
    """Noise of each group from the signals' third differences: the median over the runs."""
    found: list[list[float]] = [[], [], [], []]
    for run in runs:
        t, pose = run.pose
        found[0].append(float(np.hypot(noise_of(t, pose[:, 0]), noise_of(t, pose[:, 1])) / 2**0.5))
        found[1].append(noise_of(t, pose[:, 2]))
        found[2].append(noise_of(*run.wheel))
        found[3].append(noise_of(*run.yaw_rate))
    middle = np.array([float(np.median([v for v in f if v > 0] or [0.0])) for f in found])
    return np.asarray(np.maximum(middle, FLOORS))
