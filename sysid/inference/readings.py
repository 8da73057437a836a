"""Windows whose measurements are thinned to one reading each 50 ms.

Denser readings add nothing but rows: what is not noise of the instrument is correlated over far
longer times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import Layout, Seen, make_layout

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

HORIZON = 1.0
"""Length of a window [s]: delays, gains and tyres all show within it, nothing compounds yet."""
SPACING = 0.05
"""Time between readings [s]."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Windows with thinned measurements.

    Attributes:
        layout: windows and measurements.
        t: (R,) time of each row since its window's start [s].
        channel: (R,) 0 x, 1 y, 2 yaw, 3 wheel speed, 4 yaw rate.
        speeds: slowest and fastest [m/s].
        slot: (R,) what is compared is the mean of rows of one number; None: every row.
    """

    layout: Layout
    t: Array
    channel: Indices
    speeds: tuple[float, float]
    slot: Indices | None = None

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.layout.spans)

    def rows(self, window: int) -> slice:
        """Rows of a window."""
        return slice(int(self.layout.bounds[window]), int(self.layout.bounds[window + 1]))


def _slots(seen: Seen, spacing: float) -> Indices:
    """A number of each reading's window, instrument and multiple of `spacing`."""
    slot = np.round(seen.t / spacing).astype(np.int64)
    return np.asarray((seen.window * 3 + seen.kind) * 100_000 + slot)


def _kept(seen: Seen, spacing: float) -> NDArray[np.bool_]:
    """Of each window's and instrument's readings, the one nearest to each multiple of `spacing`."""
    key = _slots(seen, spacing)
    off = np.abs(seen.t - spacing * (key % 100_000))
    order = np.lexsort((off, key))
    first = np.ones(len(order), bool)
    first[1:] = key[order][1:] != key[order][:-1]
    kept = np.zeros(len(order), bool)
    kept[order[first]] = True
    return kept


def thin(layout: Layout, spacing: float = SPACING) -> tuple[Layout, Array, Indices]:
    """The layout with fewer readings; time and channel of each row beside it."""
    seen, kept = layout.seen, _kept(layout.seen, spacing)
    width = np.where(seen.kind == 0, 3, 1)[kept]
    ends = np.cumsum(width)
    starts = ends - width
    window = np.repeat(seen.window[kept], width)
    within = np.arange(ends[-1]) - np.repeat(starts, width)
    old = np.repeat(seen.row[kept], width) + within
    order = np.argsort(window, kind="stable")
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    thinner = replace(
        layout,
        seen=Seen(seen.window[kept], seen.t[kept], seen.kind[kept], place[starts]),
        values=layout.values[old][order],
        group=layout.group[old][order],
        bounds=np.searchsorted(window[order], np.arange(len(layout.spans) + 1)),
    )
    t = np.repeat(seen.t[kept], width)[order]
    channel = (np.array([0, 3, 4])[np.repeat(seen.kind[kept], width)] + within)[order]
    return thinner, t, channel


def make_readings(
    runs: Sequence[Run],
    pose_delay: float,
    speeds: tuple[float, float],
    horizon: float = HORIZON,
    most: float = np.inf,
    means: bool = False,
) -> Readings:
    """Cut runs into windows and thin their measurements.

    Args:
        runs: on one grid.
        pose_delay: how late poses are, as far as it is known [s].
        speeds: slowest and fastest [m/s].
        horizon: length of a window [s].
        most: take windows of so much driving in all, evenly from the whole [s].
        means: compare means over `SPACING` instead of single readings: where instruments' noise is
            all that is random, every reading counts.

    Raises:
        ValueError: the runs' grids differ, or no window sees enough poses.
    """
    layout = make_layout(runs, horizon, pose_delay, most)
    if not means:
        return Readings(*thin(layout), speeds)
    seen, rows = layout.seen, len(layout.values)
    t, channel, slot = np.empty(rows), np.empty(rows, np.int64), np.empty(rows, np.int64)
    key = 3 * _slots(seen, SPACING)
    for number in range(3):
        mine = (seen.kind == 0) | (number == 0)
        at = seen.row[mine] + number
        t[at], slot[at] = seen.t[mine], key[mine] + number
        channel[at] = np.array([0, 3, 4])[seen.kind[mine]] + number
    return Readings(layout, t, channel, speeds, slot)
