"""The page of `steerd plot`: one file with its data, its script and its style; no network."""

# Why: docs/decisions/rooms-and-code.md#d29

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from steerd.daemon.common.screen import clean
from steerd.daemon.sessions.curves import BREAK, VALUE, Grid, decimate, make_grid, pack
from steerd.daemon.sessions.info import SessionReport
from steerd.daemon.sessions.motion import GAP_MAX, Array, Track
from steerd.daemon.sessions.plot_data import Drawing
from steerd.daemon.sessions.text import when
from steerd.sysid.report.page import render_page

SIZE_MAX = 2_000_000  # a page must fit into a mail and open quickly [bytes]
BUCKETS = (20_000, 12_000, 6_000, 2_000)
"""Pairs of slots for all curves: the first number whose page is small enough is taken."""
TRACK_SLOTS = 12_000  # largest number of points of the track
LANE_POINTS = 1500  # largest number of points of the lane
WARNINGS_SHOWN = 8
_TEMPLATE = Path(__file__).parent / "page" / "plot.html"


def make_page(report: SessionReport, drawing: Drawing) -> str:
    """The whole page; curves are thinned until it is smaller than `SIZE_MAX`.

    Args:
        report: of the session.
        drawing: its curves.
    """
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
        "lane": _lane(drawing),
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
    shown = np.isfinite(e1).any() if e1.size else False
    colour = np.abs(e1 if shown else track.speed)
    finite = colour[np.isfinite(colour)]
    top = float(np.quantile(finite, 0.999)) if finite.size else 1.0
    columns = {"x": track.x, "y": track.y, "yaw": track.yaw, "c": colour}
    packed: dict[str, Any] = {}
    for name, column in columns.items():
        value = np.interp(at, t, column)
        bad = gone | ~np.isfinite(value)
        kinds = np.where(bad, BREAK, VALUE).astype(np.uint8)
        packed[name] = pack(np.where(bad, 0.0, value), kinds)
    about = ("|e1|", "mm", 1e3) if shown else ("speed", "m/s", 1.0)
    named = dict(zip(("colour", "unit", "factor"), about, strict=True))
    return {**packed, **named, "grid": asdict(grid), "top": max(top, 1e-6)}


def _lane(drawing: Drawing) -> dict[str, Any] | None:
    lane = drawing.lane
    if lane is None:
        return None
    stride = max(1, len(lane.x) // LANE_POINTS)
    keep = [*range(0, len(lane.x), stride)]
    if not lane.closed and keep[-1] != len(lane.x) - 1:
        keep.append(len(lane.x) - 1)
    return {
        "x": [round(lane.x[i], 4) for i in keep],
        "y": [round(lane.y[i], 4) for i in keep],
        "closed": lane.closed,
        "half": drawing.half_width,
    }
