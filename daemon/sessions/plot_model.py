"""What the learner reported during a drive, as panels of the plot page."""

from dataclasses import replace
from math import degrees

import numpy as np

from steerd.daemon.sessions.info import Recording
from steerd.daemon.sessions.motion import Array
from steerd.daemon.sessions.plot_data import Curve, Drawing, Panel
from steerd.steer_bus import topics
from steerd.steer_bus.topic_columns import Columns

BAND = 2.0
"""Standard deviations to either side: 95 % of a normal distribution."""
PANELS: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
    ("learnt: gains", "", ("steer_gain", "speed_gain"), 1.0),
    ("learnt: steering bias", "°", ("steer_bias",), degrees(1.0)),
    ("learnt: steering dead time and lag", "ms", ("steer_delay", "steer_lag"), 1e3),
    ("learnt: cornering coefficients", "1/rad", ("c_sf", "c_sr"), 1.0),
)
"""Title, unit, the fields of the message that are drawn, and their scale."""
_ROLES = ("estimate", "measured")


def with_model(drawing: Drawing, read: Recording) -> Drawing:
    """The drawing with the panels of the learner, if it ran: bands, and the moments of change."""
    table = read.table(topics.MODEL)
    if table is None:
        return drawing
    t, panels = read.times(table), list(drawing.panels)
    for title, unit, fields, scale in PANELS:
        curves = [
            curve
            for field, role in zip(fields, _ROLES, strict=False)
            for curve in _banded(table, t, field, role, scale)
        ]
        if curves:
            panels.append(Panel(title, unit, (*curves, *_moments(table, t, curves))))
    return replace(drawing, panels=tuple(panels))


def _banded(table: Columns, t: Array, field: str, role: str, scale: float) -> list[Curve]:
    """A parameter and its band, where it was learnt."""
    value, sd = table[field].astype(float), table[f"{field}_sd"].astype(float)
    known = np.isfinite(value)
    if not known.any():
        return []
    t, value, width = t[known], scale * value[known], scale * BAND * sd[known]
    return [
        Curve(field, role, t, value),
        Curve(f"{field}, 95 %", "bound", t, value + width),
        Curve(f"{field}, 95 %", "bound", t, value - width),
    ]


def _moments(table: Columns, t: Array, curves: list[Curve]) -> list[Curve]:
    """An upright line where each change began."""
    since = table["since_ns"].astype(np.int64)
    low = min(float(curve.value.min()) for curve in curves)
    high = max(float(curve.value.max()) for curve in curves)
    lines = []
    for moment in np.unique(since[since >= 0]):
        row = int(np.flatnonzero(since == moment)[-1])
        at = t[row] + 1e-9 * float(moment - int(table["mono_ns"][row]))
        name = str(table["effect"][row]) or str(table["verdict"][row])
        ends = np.array([at, at + 1e-3])
        lines.append(Curve(f"change: {name}", "command", ends, np.array([low, high])))
    return lines
