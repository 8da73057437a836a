"""The diagrams of an identification."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from steerd.sysid.data.windows import GROUPS
from steerd.sysid.estimation.outcome import Fit, HeldOut, Outcome, Residuals, Row
from steerd.sysid.estimation.validation import Trace
from steerd.sysid.paper import SearchHistory
from steerd.sysid.report.design_comparison import Profile
from steerd.sysid.report.drawing import (
    AFTER,
    BEFORE,
    FAINT,
    INK,
    LINES,
    MEASURED,
    Diagrams,
    scale_bars,
)
from steerd.sysid.report.report import DEGREES

UNITS = {"position": (1e3, "mm"), "yaw": (DEGREES, "°"), "wheel_speed": (1e3, "mm/s"),
         "yaw_rate": (DEGREES, "°/s")}  # fmt: skip
POINTS_MAX = 1500


def draw_main(outcome: Outcome) -> list[Diagrams]:
    """Predictions, their errors and the parameters: what is drawn of every identification."""
    colours = {"measured": MEASURED, "start values": BEFORE, "identified": AFTER}
    return [
        Diagrams(plot_traces, 4.0, [outcome.traces], 2, colours=colours),
        Diagrams(plot_held_out, 2.6, [outcome.held_out], 2),
        Diagrams(plot_parameters, 2.4, [outcome.free_rows], columns=1),
    ]


def plot_traces(plane: Axes, late: Axes, traces: tuple[list[Trace], list[Trace]]) -> None:
    """Held-out windows in the plane, and how far off predictions (after, before) are with time."""
    for after, before in zip(*traces, strict=True):
        plane.plot(*after.measured[:, :2].T, color=MEASURED, lw=2.2, alpha=0.35)
        for trace, colour in ((before, BEFORE), (after, AFTER)):
            plane.plot(*trace.predicted[trace.ahead >= 0.0, :2].T, color=colour, lw=1.0)
            off = np.linalg.norm(trace.measured[:, :2] - trace.predicted[:, :2], axis=1)
            late.plot(trace.ahead, 1e3 * off, color=colour, lw=0.8, alpha=0.7)
    plane.set(xlabel="x [m]", ylabel="y [m]", title="held-out drives and their predictions")
    plane.set_aspect("equal", adjustable="datalim")
    late.axvline(0.0, color=FAINT, lw=0.8)
    late.set(xlabel="time since the prediction began [s]", ylabel="distance [mm]",
             title="prediction error of each window", ylim=(0.0, None))  # fmt: skip


def plot_held_out(left: Axes, right: Axes, held_out: Sequence[HeldOut]) -> None:
    """RMS position (left) and heading (right) errors at the horizons, before and after."""
    places = np.arange(len(held_out))
    for axis, field, scale, unit in (
        (left, "position", 1e3, "mm"),
        (right, "heading", DEGREES, "°"),
    ):
        heights = []
        for shift, name, colour in ((-0.2, "before", BEFORE), (0.2, "after", AFTER)):
            values = [scale * getattr(getattr(h, name), field) for h in held_out]
            axis.bar(places + shift, values, 0.36, color=colour)
            heights += values
        axis.set(xticks=places, title=f"{field} [{unit}]")
        scale_bars(axis, heights)
        axis.set_xticklabels([f"{h.after.horizon:g} s" for h in held_out])
    left.set_ylabel("root mean square")


def plot_residuals(over: Any, spread: Any, left: Residuals, group: int) -> None:
    """Residuals of a kind over time, and their spread against the signal's own noise."""
    mine = left.group == group
    scale, unit = UNITS[GROUPS[group]]
    values = scale * left.error[mine]
    step = max(1, len(values) // POINTS_MAX)
    over.plot(left.t[mine][::step], values[::step], ".", ms=1.2, color=AFTER)
    over.set(
        title="residuals of the fit", xlabel="time into each drive [s]",
        ylabel=f"{GROUPS[group]} [{unit}]".replace("_", " "),
    )  # fmt: skip
    edge = max(4.0 * float(np.sqrt(np.mean(values**2))), 1e-6)
    bins = np.linspace(-edge, edge, 60)
    spread.hist(values, bins, color=AFTER, alpha=0.7, density=True)
    sigma = scale * float(left.signal[group])
    bell = np.exp(-0.5 * (bins / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
    spread.plot(bins, bell, color=INK, lw=1.0)
    spread.set_title("their spread; the line is the instrument's own noise")


def plot_correlation(axes: Axes, found: Fit) -> None:
    """Correlation of the coordinates."""
    labels = found.labels
    axes.grid(visible=False)
    axes.imshow(found.correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    places = range(len(labels))
    axes.set_xticks(places, labels, rotation=90)
    axes.set_yticks(places, labels)
    for i in places:
        for j in places:
            value = found.correlation[i, j]
            ink = "white" if abs(value) > 0.6 else "black"
            axes.text(j, i, f"{value:z.1f}", ha="center", va="center", fontsize=6.0, color=ink)


def plot_searches(left: Axes, right: Axes, searches: Sequence[SearchHistory]) -> None:
    """The paper's loss curves: every start's, iterations along x, shifted to be positive."""
    floor = min(float(search.losses.min()) for search in searches if len(search.losses))
    for number, search in enumerate(searches):
        colour = LINES[number % len(LINES)]
        best = np.minimum.accumulate(search.losses) - floor + 1e-3
        left.plot(search.losses - floor + 1e-3, color=colour, lw=0.6, alpha=0.5)
        left.plot(best, color=colour, lw=1.4, label=f"start {number + 1}")
        right.plot(search.path[:, 2], search.path[:, 3], color=colour, lw=1.0)
        right.plot(*search.path[0, 2:], "o", color=colour, mfc="white")
        right.plot(*search.final[2:], "o", color=colour)
    left.set(yscale="log", xlabel="iterations", ylabel="loss above the lowest")
    left.set_title("loss of the batch, and the best so far")
    right.set(xlabel="C_Sf", ylabel="C_Sr", title="stiffness from start (hollow) to end")
    left.legend(fontsize=8)


def draw_profiles(profiles: Sequence[Profile]) -> Diagrams:
    """Lateral and heading error of each design, a column a floor."""
    names = dict.fromkeys(p.design for p in profiles)
    colours = dict(zip(names, (INK, AFTER, BEFORE), strict=False))
    floors = list(dict.fromkeys(p.friction for p in profiles))

    def plot(*axes: Axes) -> None:
        for e1, e2, floor in zip(axes, axes[len(floors) :], floors, strict=False):
            for profile in (p for p in profiles if p.friction == floor):
                t, off, turned = profile.rows.T
                e1.plot(t, 1e3 * off, color=colours[profile.design], lw=1.1)
                e2.plot(t, np.degrees(turned), color=colours[profile.design], lw=1.1)
            e1.set(title=f"e1 [mm], {floor} friction", xlabel="time [s]")
            e2.set(title=f"e2 [°], {floor} friction", xlabel="time [s]")

    said = {f"designed from {name}": colour for name, colour in colours.items()}
    return Diagrams(plot, 2.2, count=2 * len(floors), colours=said)


def plot_parameters(axis: Axes, free: Mapping[str, Row]) -> None:
    """Change of each parameter in percent of its start value, with 95 % intervals."""
    rows = {name: row for name, row in free.items() if row.start}
    for place, row in enumerate(rows.values()):
        scale = 100.0 / abs(row.start)
        colour = AFTER if row.identifiable else FAINT
        axis.errorbar(
            place, scale * (row.value - row.start), yerr=1.96 * scale * (row.sd or 0.0),
            fmt="o", color=colour, ecolor=colour, ms=4.0, capsize=2.0,
        )  # fmt: skip
    axis.axhline(0.0, color=INK, lw=0.8)
    axis.set_yscale("symlog", linthresh=10.0)
    axis.set_xticks(range(len(rows)), list(rows), rotation=20, ha="right")
    axis.set(ylabel="change [%]", title="parameters against the start, 95 % intervals")
    if not all(row.identifiable for row in rows.values()):
        axis.plot([], [], "o", color=FAINT, label="not identifiable from these data")
        axis.legend(loc="best", fontsize=8)
