"""The page of `steerd plot`: one file with its data, its script and its style; no network.

All curves of a page share one grid of `slots` instants. A curve with more samples than the grid
keeps the smallest and the largest of every two slots, in the order in which they came, so that no
peak is lost however long the drive. `make_csv` gives the curves as a table instead.
"""

# Why: docs/decisions/rooms-and-code.md#d29

import base64
import csv
import io
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.path.path import Path as Lane
from steerd.daemon.common.screen import clean
from steerd.daemon.sessions.info import SessionReport
from steerd.daemon.sessions.motion import GAP_MAX, Track
from steerd.daemon.sessions.plot_data import Drawing
from steerd.daemon.sessions.text import when
from steerd.sysid.data.data_checks import Array
from steerd.sysid.report.page import render_page

SIZE_MAX = 2_000_000  # a page must fit into a mail and open quickly [bytes]
BUCKETS = (20_000, 12_000, 6_000, 2_000)
"""Pairs of slots for all curves: the first number whose page is small enough is taken."""
TRACK_SLOTS = 12_000  # largest number of points of the track
LANE_POINTS = 1500  # largest number of points of the lane
WARNINGS_SHOWN = 8
CSV_STEP = 0.01  # between rows of a table [s]: the period of a 100 Hz loop
_TEMPLATE = Path(__file__).parent / "page" / "plot.html"


def make_page(report: SessionReport, drawing: Drawing) -> str:
    """The whole page; curves are thinned until it is smaller than `SIZE_MAX`."""
    page = ""
    for buckets in BUCKETS:
        page = render_page(_TEMPLATE, data=_data(report, drawing, buckets))
        if len(page.encode()) < SIZE_MAX:
            break
    return page


def _data(report: SessionReport, drawing: Drawing, buckets: int) -> dict[str, Any]:
    grid = make_grid(0.0, max(report.info.duration_s, 0.01), buckets)
    title = (clean(report.car), clean(report.info.path.name), when(report))
    return {
        "title": " · ".join(filter(None, title)),
        "facts": list_facts(report, drawing),
        "warnings": [clean(text) for text in report.warnings[:WARNINGS_SHOWN]],
        "states": [[round(change.t_s, 4), change.state] for change in report.states],
        "grid": asdict(grid),
        "panels": [
            {
                "title": panel.title,
                "unit": panel.unit,
                "curves": [
                    {"name": c.name, "role": c.role, **pack(*decimate(grid, c.t, c.value))}
                    for c in panel.curves
                ],
            }
            for panel in drawing.panels
        ],
        "track": None if drawing.track is None else _track(drawing.track, drawing.e1),
        "lane": None if drawing.lane is None else _lane(drawing.lane, drawing.half_width),
    }


def list_facts(report: SessionReport, drawing: Drawing) -> list[tuple[str, str]]:
    """Label and value of what the page's head shows."""
    facts = [("recorded", f"{report.info.duration_s:.1f} s"), *drawing.facts]
    if drawing.lane is not None:
        facts.append(("path", clean(drawing.lane.name, 40)))
    if report.end:
        facts.append(("how it ended", clean(report.end, 80)))
    return facts


def _track(track: Track, e1: Array) -> dict[str, Any]:
    """The track at equal times, coloured by the lateral error, or by speed without one."""
    t = track.t
    slots = min(TRACK_SLOTS, 2 * len(t))
    span = max(float(t[-1] - t[0]), 1e-3)
    grid = Grid(float(t[0]), span / (slots - 1), slots)
    at = np.minimum(grid.start + grid.step * np.arange(slots), t[-1])
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    gone = t[after] - t[after - 1] > GAP_MAX
    shown = np.isfinite(e1).any()
    colour = np.abs(e1 if shown else track.speed)
    finite = colour[np.isfinite(colour)]
    top = float(np.quantile(finite, 0.999)) if finite.size else 1.0
    packed: dict[str, Any] = {}
    for name, column in (("x", track.x), ("y", track.y), ("yaw", track.yaw), ("c", colour)):
        value = np.interp(at, t, column)
        bad = gone | ~np.isfinite(value)
        kinds = np.where(bad, BREAK, VALUE).astype(np.uint8)
        packed[name] = pack(np.where(bad, 0.0, value), kinds)
    named = {"colour": "|e1|", "unit": "mm", "factor": 1e3}
    if not shown:
        named = {"colour": "speed", "unit": "m/s", "factor": 1.0}
    return {**packed, **named, "grid": asdict(grid), "top": max(top, 1e-6)}


def _lane(lane: Lane, half: float) -> dict[str, Any]:
    keep = [*range(0, len(lane.x), max(1, len(lane.x) // LANE_POINTS))]
    if not lane.closed and keep[-1] != len(lane.x) - 1:
        keep.append(len(lane.x) - 1)
    x, y = ([round(axis[i], 4) for i in keep] for axis in (lane.x, lane.y))
    return {"x": x, "y": y, "closed": lane.closed, "half": half}


def make_csv(drawing: Drawing) -> str:
    """Track and curves as a table, every `CSV_STEP`, empty where a curve has no value."""
    columns = []
    if (track := drawing.track) is not None:
        places = (("x [m]", track.x), ("y [m]", track.y), ("yaw [°]", np.degrees(track.yaw)))
        columns += [(head, track.t, value) for head, value in places]
    columns += [
        (f"{panel.title}: {curve.name} [{panel.unit or 1}]", curve.t, curve.value)
        for panel in drawing.panels
        for curve in panel.curves
    ]
    steps = 1 + int(max((t[-1] for _, t, _ in columns), default=0.0) / CSV_STEP)
    at = CSV_STEP * np.arange(steps)
    values = [np.interp(at, t, value, np.nan, np.nan) for _, t, value in columns]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["t [s]", *(head for head, _, _ in columns)])
    for row in zip(at, *values, strict=True):
        table.writerow([f"{value:.7g}" if np.isfinite(value) else "" for value in row])
    return text.getvalue()


# -- curves of many samples as little text -------------------------------------------------------

HELD, VALUE, BREAK = 0, 1, 2
"""What a slot holds: nothing new (the line passes through), a value, or a break in the line."""
LEVELS = 65535  # largest level of a packed value: 16 bits
FINEST_S = 0.005  # shortest pair of slots [s]; half the period of a 100 Hz loop


@dataclass(frozen=True, slots=True)
class Grid:
    """Instants `start + i * step` for `i < slots`; `slots` is even [s]."""

    start: float
    step: float
    slots: int


def make_grid(start: float, end: float, buckets: int) -> Grid:
    """A grid over [start, end] of at most `buckets` pairs of slots, each pair >= `FINEST_S`."""
    span = max(end - start, FINEST_S)
    count = max(1, min(buckets, round(span / FINEST_S)))
    return Grid(start, span / (2 * count), 2 * count)


def decimate(grid: Grid, t: Array, value: Array) -> tuple[Array, NDArray[np.uint8]]:
    """Values (0 where none) and kinds (`HELD`, `VALUE`, `BREAK`) of a curve on a grid, (slots,).

    Its times [s] do not decrease (n,); where a value (n,) is NaN the line breaks.
    """
    out, kinds = np.zeros(grid.slots), np.zeros(grid.slots, np.uint8)
    bucket = np.floor((t - grid.start) / (2.0 * grid.step)).astype(np.int64)
    bucket = np.minimum(bucket, grid.slots // 2 - 1)
    known = np.isfinite(value) & (bucket >= 0)
    gone = np.unique(bucket[~np.isfinite(value) & (bucket >= 0)])
    kinds[2 * gone] = BREAK
    value, bucket = value[known], bucket[known]
    if not len(value):
        return out, kinds
    order = np.lexsort((value, bucket))
    first = np.flatnonzero(np.diff(bucket[order], prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    low, high = order[first], order[last]
    # A stable order of the extremes: the one that came first takes the first slot.
    early, late = np.minimum(low, high), np.maximum(low, high)
    place = 2 * bucket[early]
    out[place], kinds[place] = value[early], VALUE
    two = late > early
    out[place[two] + 1], kinds[place[two] + 1] = value[late[two]], VALUE
    # A break lasts until the next value.
    at = np.maximum.accumulate(np.where(kinds == HELD, 0, np.arange(len(kinds))))
    return out, np.where((kinds == HELD) & (kinds[at] == BREAK), BREAK, kinds)


def pack(out: Array, kinds: NDArray[np.uint8]) -> dict[str, float | str]:
    """A decimated curve for the page: 16 bit levels between `low` and `high`, differences, deflate.

    The bytes are the kinds, then the low and the high bytes of the levels' differences modulo
    65536 (a slot without a value repeats the level before it).
    """
    known = kinds == VALUE
    low = float(out[known].min()) if known.any() else 0.0
    high = float(out[known].max()) if known.any() else 1.0
    held = np.maximum.accumulate(np.where(known, np.arange(len(out)), -1))
    shown = np.where(held >= 0, out[held], low)
    level = np.rint(LEVELS * ((shown - low) / ((high - low) or 1.0))).astype(np.int64)
    steps = np.diff(level, prepend=0) % (LEVELS + 1)
    planes = kinds.tobytes() + (steps & 255).astype(np.uint8).tobytes()
    planes += (steps >> 8).astype(np.uint8).tobytes()
    text = base64.b64encode(zlib.compress(planes, 9)).decode()
    return {"low": low, "high": high if high > low else low, "data": text}
