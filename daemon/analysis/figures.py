"""What notebooks plot: one matplotlib figure of a drive, an identification or a diagnosis."""

import io
from collections.abc import Mapping

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from steerd.daemon.sessions.plot_data import Drawing, Panel
from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.report.gap_figures import (
    effect_colours,
    find_measured,
    plot_candidates,
    plot_gap,
    plot_timeline,
)
from steerd.sysid.estimation.outcome import Outcome
from steerd.sysid.report.drawing import AFTER, BEFORE, FAINT, INK, MEASURED, STYLE, WIDTH
from steerd.sysid.report.identify_report import COLOURS as FITTED
from steerd.sysid.report.identify_report import plot_held_out, plot_traces

PANELS = ("lateral error e1", "heading error e2", "speed", "steering angle (left +)", "yaw rate")
"""Panels of the drive's page that the figure shows; the others stay on the page."""
COLOURS = {
    "command": BEFORE, "estimate": AFTER, "measured": MEASURED, "other": "#862e9c", "bound": FAINT,
}  # fmt: skip
POINTS_MAX = 4000
"""More points than this on one curve are not visible."""
TIMELINES = 3


def plot_session(drawing: Drawing, title: str) -> Figure:
    """Track over lane on the left, panels over time on the right.

    Args:
        drawing: of the session.
        title: of the figure.
    """
    panels = [panel for panel in drawing.panels if panel.title in PANELS] or [Panel("", "", ())]
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, max(3.5, 1.25 * len(panels))), layout="constrained")
        grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.3))
        _plot_track(figure, figure.add_subplot(grid[:, 0]), drawing)
        first: Axes | None = None
        for row, panel in enumerate(panels):
            axis = figure.add_subplot(grid[row, 1], sharex=first)
            _plot_panel(axis, panel)
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


def _plot_panel(axis: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        step = max(1, len(curve.t) // POINTS_MAX)
        axis.plot(
            curve.t[::step], curve.value[::step], color=COLOURS.get(curve.role, INK), lw=0.9,
            label=curve.name,
        )  # fmt: skip
    axis.set(title=panel.title, ylabel=f"[{panel.unit}]" if panel.unit else "")
    if len(panel.curves) > 1:
        axis.legend(
            loc="lower right", bbox_to_anchor=(1.0, 0.97), fontsize=7, ncols=len(panel.curves)
        )


def plot_identification(outcome: Outcome) -> Figure:
    """Held-out predictions, their errors by horizon, parameters against their start values."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 8.0), layout="constrained")
        grid = figure.add_gridspec(3, 2, height_ratios=(1.5, 1.0, 1.0))
        plot_traces(figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1]), outcome.traces)
        left, right = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
        plot_held_out(left, right, outcome.held_out)
        _plot_parameters(figure.add_subplot(grid[2, :]), outcome)
        return _name_colours(figure, FITTED)


def _name_colours(figure: Figure, colours: Mapping[str, str]) -> Figure:
    lines = [Line2D([], [], color=colour, lw=3.0, label=name) for name, colour in colours.items()]
    figure.legend(handles=lines, fontsize=8, loc="outside upper right", ncols=len(lines))
    return figure


def _plot_parameters(axis: Axes, outcome: Outcome) -> None:
    """Change of each parameter in percent of its start value, with 95 % intervals."""
    rows = {name: row for name, row in outcome.free_rows.items() if row.before}
    for place, row in enumerate(rows.values()):
        scale = 100.0 / abs(row.before)
        colour = AFTER if row.identifiable else FAINT
        axis.errorbar(
            place, scale * (row.value - row.before), yerr=1.96 * scale * (row.sd or 0.0),
            fmt="o", color=colour, ecolor=colour, ms=4.0, capsize=2.0,
        )  # fmt: skip
    axis.axhline(0.0, color=INK, lw=0.8)
    axis.set_yscale("symlog", linthresh=10.0)
    axis.set_xticks(range(len(rows)), list(rows), rotation=20, ha="right")
    axis.set(ylabel="change [%]", title="parameters against the start, 95 % intervals")
    if not all(row.identifiable for row in rows.values()):
        axis.plot([], [], "o", color=FAINT, label="not identifiable from these data")
        axis.legend(loc="best", fontsize=8)


def plot_diagnosis(found: Diagnosis) -> Figure:
    """Prediction errors before and after, candidate effects, the gap over time."""
    explained, line = bool(found.causes), found.timeline
    runs = list(dict.fromkeys(line.run))[:TIMELINES] if line is not None else []
    present = find_measured(found.before)
    rows = 0.24 * max(len(found.candidates), 6)
    with rc_context(STYLE):
        heights = (2.4, rows, *(1.5 for _ in runs))
        figure = Figure(figsize=(WIDTH, sum(heights) + 1.0), layout="constrained")
        grid = figure.add_gridspec(len(heights), len(present), height_ratios=heights)
        top = [figure.add_subplot(grid[0, column]) for column in range(len(present))]
        plot_gap(top, found)
        plot_candidates(figure.add_subplot(grid[1, :]), found)
        for row, run in enumerate(runs, 2):
            axis = figure.add_subplot(grid[row, :])
            if line is not None:
                plot_timeline(axis, line, run, found.where.windows, explained)
                axis.set_xlabel("time into the drive [s]" if run == runs[-1] else "")
        causes = " and ".join(cause.effect for cause in found.causes)
        figure.suptitle(f"{found.verdict}: {causes}" if causes else found.verdict, fontsize=10)
        return _name_colours(figure, effect_colours(explained=explained))
