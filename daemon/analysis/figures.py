"""What notebooks plot of a drive: one matplotlib figure."""

import io

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from steerd.daemon.sessions.plot_data import Drawing, Panel
from steerd.sysid.report.drawing import AFTER, BEFORE, FAINT, INK, MEASURED, STYLE, WIDTH

PANELS = ("lateral error e1", "heading error e2", "speed", "steering angle (left +)", "yaw rate")
"""Panels of the drive's page that the figure shows; the others stay on the page."""
COLOURS = {
    "command": BEFORE, "estimate": AFTER, "measured": MEASURED, "other": "#862e9c", "bound": FAINT,
}  # fmt: skip
POINTS_MAX = 4000  # more points than this on one curve are not visible


def plot_session(drawing: Drawing, title: str) -> Figure:
    """Track over lane on the left, panels over time on the right."""
    panels = [panel for panel in drawing.panels if panel.title in PANELS] or [Panel("", "", ())]
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, max(3.5, 1.25 * len(panels))), layout="constrained")
        grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.3))
        _plot_track(figure, figure.add_subplot(grid[:, 0]), drawing)
        first: Axes | None = None
        for row, panel in enumerate(panels):
            axis = figure.add_subplot(grid[row, 1], sharex=first)
            for curve in panel.curves:
                step = max(1, len(curve.t) // POINTS_MAX)
                axis.plot(
                    curve.t[::step], curve.value[::step], color=COLOURS.get(curve.role, INK),
                    lw=0.9, label=curve.name,
                )  # fmt: skip
            axis.set(title=panel.title, ylabel=f"[{panel.unit}]" if panel.unit else "")
            if len(panel.curves) > 1:
                place, count = (1.0, 0.97), len(panel.curves)
                axis.legend(loc="lower right", bbox_to_anchor=place, fontsize=7, ncols=count)
            axis.tick_params(labelbottom=row == len(panels) - 1)
            first = first or axis
        if first is not None:
            figure.axes[-1].set_xlabel("time since the session's start [s]")
        figure.suptitle(title, fontsize=10)
        return figure


def save_figure(figure: Figure, form: str) -> bytes:
    """The file of a figure: `png`, `svg` or `pdf`; the same figure gives the same bytes."""
    content = io.BytesIO()
    about = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[form]
    with rc_context(STYLE):
        figure.savefig(content, format=form, dpi=200, metadata=about)
    return content.getvalue()


def _plot_track(figure: Figure, axis: Axes, drawing: Drawing) -> None:
    if drawing.lane is not None:
        lane = drawing.lane
        axis.plot(lane.x, lane.y, color=FAINT, lw=1.0, ls="--", label="path")
    track = drawing.track
    if track is not None:
        step = max(1, len(track.t) // POINTS_MAX)
        error = 1e3 * np.abs(drawing.e1[::step])
        if np.isfinite(error).any():
            dots = axis.scatter(track.x[::step], track.y[::step], c=error, s=3, cmap="viridis")
            figure.colorbar(dots, ax=axis, location="bottom", label="|e1| [mm]", shrink=0.8)
        else:
            axis.plot(track.x[::step], track.y[::step], color=AFTER, lw=1.0)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x [m]", ylabel="y [m]", title="track")
    if drawing.lane is not None:
        axis.legend(loc="upper right", fontsize=8)
