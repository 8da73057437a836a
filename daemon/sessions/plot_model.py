"""What the learner reported during a drive, as panels of the plot page."""

from dataclasses import replace
from math import degrees
from typing import NamedTuple

import numpy as np

from steerd.daemon.common.translate import make_session_error
from steerd.daemon.sessions.info import Times
from steerd.daemon.sessions.motion import Array
from steerd.daemon.sessions.plot_data import Curve, Drawing, Panel
from steerd.steer_bus import topics
from steerd.steer_bus.session_read import Session, SessionError
from steerd.steer_bus.topic_columns import Columns
from steerd.steer_bus.topics import split_key

BAND = 2.0
"""Standard deviations to either side: 95 % of a normal distribution."""


class Shown(NamedTuple):
    """One panel: its title, unit and the fields of the message that it draws."""

    title: str
    unit: str
    fields: tuple[str, ...]
    scale: float = 1.0


PANELS: tuple[Shown, ...] = (
    Shown("learnt: gains", "", ("steer_gain", "speed_gain")),
    Shown("learnt: steering bias", "°", ("steer_bias",), degrees(1.0)),
    Shown("learnt: steering dead time and lag", "ms", ("steer_delay", "steer_lag"), 1e3),
    Shown("learnt: cornering coefficients", "1/rad", ("c_sf", "c_sr")),
)
_ROLES = ("estimate", "measured")


def with_model(drawing: Drawing, session: Session) -> Drawing:
    """The drawing with the panels of the learner, if it ran.

    Raises:
        SteerdError: the file has changed since it was opened.
    """
    info = session.info()
    names = [
        topic.name
        for topic in info.topics
        if topic.count and (split_key(topic.name) or ("", ""))[1] == topics.MODEL.name
    ]
    if not names:
        return drawing
    try:
        table = session.tables({names[0]: topics.MODEL.message})[names[0]]
    except SessionError as error:
        raise make_session_error(error) from None
    return replace(drawing, panels=drawing.panels + model_panels(table, Times(info.start_ns)))


def model_panels(table: Columns, times: Times) -> tuple[Panel, ...]:
    """Parameters over time with bands, and the moments of change."""
    t = times.of(table["stamp_ns"])
    panels = []
    for shown in PANELS:
        curves = [
            curve
            for field, role in zip(shown.fields, _ROLES, strict=False)
            for curve in _banded(table, t, field, role, shown.scale)
        ]
        if curves:
            moments = _moments(table, t, curves)
            panels.append(Panel(shown.title, shown.unit, (*curves, *moments)))
    return tuple(panels)


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
