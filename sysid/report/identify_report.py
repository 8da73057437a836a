"""The report of `steerd identify`: one HTML file without links, results first, figures inline."""

from collections.abc import Iterator, Sequence
from math import degrees, isnan

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from numpy.typing import NDArray

from steerd.sysid.data.windows import GROUPS
from steerd.sysid.estimation.outcome import Fit, HeldOut, Outcome
from steerd.sysid.estimation.validation import Trace
from steerd.sysid.paper.search_history import SearchHistory
from steerd.sysid.report.design_comparison import FRICTIONS, Profile, compare_designs
from steerd.sysid.report.drawing import (
    AFTER,
    BEFORE,
    FAINT,
    INK,
    LINES,
    MEASURED,
    STYLE,
    draw,
    make_axes,
    scale_bars,
    to_svg,
)
from steerd.sysid.report.report import DEGREES, Card, Cell, Fold, Report, Section, Table, with_error

COLOURS = {"measured": MEASURED, "start values": BEFORE, "identified": AFTER}
IMPROVEMENT_MIN = 1.02
"""A smaller factor is no improvement."""


@rc_context(STYLE)
def make_report(outcome: Outcome) -> Report:
    """What an identification found."""
    truth = {} if outcome.truth is None else {"truth": outcome.truth}
    designs = {**truth, "identified": outcome.after, "start values": outcome.before}
    profiles = compare_designs(outcome.truth or outcome.after, designs)
    e = outcome.excitation
    return Report(
        title="The car identified from these drives",
        subject=", ".join(outcome.sessions),
        about=f"{e.seconds:.0f} s, {e.distance:.0f} m, "
        f"{e.speed_low:.1f} to {e.speed_high:.1f} m/s, {e.lateral_accel:.1f} m/s² sideways · "
        f"method {outcome.method}, {outcome.seconds:.1f} s",
        lead="What the drives say of the car, judged by drives that were not fitted.",
        sections=[_values(outcome), *_sections(outcome, profiles)],
        foot="Written by steerd identify. Frames are ISO 8855, angles positive to the left; "
        "sd is one standard error.",
        cards=list(make_cards(outcome)),
    )


def make_cards(outcome: Outcome) -> Iterator[Card]:
    """The figures that are read first."""
    free = outcome.free_rows.values()
    count = sum(row.identifiable for row in free)
    yield Card("identifiable", f"{count} of {len(free)}", "free parameters, from these drives")
    for last in [h for h in outcome.held_out if not isnan(h.after.position)][-1:]:
        before, after = last.before, last.after
        better = last.factor >= IMPROVEMENT_MIN
        change = f"the error falls by a factor of {last.factor:.1f}" if better else "no improvement"
        figure = f"{1e3 * before.position:.1f} → {1e3 * after.position:.1f} mm"
        yield Card(f"off {after.horizon:g} s ahead, by start values → identified", figure, change)
        figure = f"{degrees(before.heading):.2f} → {degrees(after.heading):.2f}°"
        yield Card("off in heading", figure, "both on drives that were not fitted")


def _values(outcome: Outcome) -> Section:
    """The parameters: free, combined, fixed."""
    lacks = [f"Excitation: {lack}." for lack in outcome.excitation.lacking]
    heads = ["parameter", "value ± sd", "unit", "start", "true", ""]
    truth = outcome.truth._asdict() if outcome.truth is not None else {}
    rows = []
    for name, row in outcome.free_rows.items():
        remark = "" if row.identifiable else f"not identifiable; {row.manoeuvre}"
        unit = "" if row.unit == "1" else row.unit
        true = f"{truth[name]:.5g}" if name in truth else ""
        texts = [name, with_error(row.value, row.sd), unit, f"{row.before:.5g}", true, remark]
        rows.append([Cell(text, "" if row.identifiable else "quiet") for text in texts])
    table = Table(heads, rows, words=[len(heads) - 1])
    known = [f"{c.text} = {c.value:.5g} ± {c.sd:.2g} m" for c in outcome.combinations if c.known]
    combined = [f"Identifiable combination: {text}." for text in known if outcome.unidentified]
    fixed = [
        f"{name} = {row.value:.5g} {row.unit if row.unit != '1' else ''}".rstrip()
        for name, row in outcome.rows.items()
        if not row.free
    ]
    return Section(
        notes=[*outcome.notes, *lacks, *combined],
        table=table if truth else table.pick(*(head for head in heads if head != "true")),
        fold=Fold("fixed parameters", ", ".join(fixed)),
    )


def _sections(outcome: Outcome, profiles: tuple[Profile, ...]) -> Iterator[Section]:
    yield Section(
        "Prediction of drives that were not fitted",
        f"Validated on {outcome.held_out_of}. Open loop: the state is fitted to the 0.4 s before, "
        "then only the commands are known.",
        figure=draw(plot_held_out, 2.6, outcome.held_out, columns=2, colours=COLOURS)
        + draw(plot_traces, 4.0, outcome.traces, columns=2),
    )
    plant = "the identified car" if outcome.truth is None else "the true (simulated) car"
    yield Section(
        "Lane keeping with controllers designed from these parameters",
        f"A figure eight at up to 2 m/s from 0.15 m beside it, on {plant}. {_closed(profiles)}",
        figure=draw_profiles(profiles),
    )
    if outcome.fit is not None:
        yield Section(
            "Residuals",
            "Flat and as narrow as the line: the model explains the drive. Waves or a wide "
            "spread: something is missing, and steerd diagnose looks for it.",
            figure=draw_residuals(outcome.fit),
        )
        yield Section(
            "Correlation of the estimates",
            "Near ±1: the data identify the combination, not its members.",
            figure=draw(plot_correlation, 4.6, outcome.fit),
        )
    if outcome.searches:
        yield Section(
            "Convergence",
            "Parameters that stay near their starts do not change the loss: "
            "they are not identifiable.",
            figure=draw(plot_searches, 3.0, outcome.searches, columns=2),
        )


def _closed(profiles: tuple[Profile, ...]) -> str:
    parts = []
    for p in profiles:
        result = f"refused ({p.refused})" if p.refused else f"{p.rms * 1e3:.1f} mm"
        parts.append(f"{p.design}, {p.friction} friction: {result}")
    return "RMS of e1: " + "; ".join(parts) + "."


Array = NDArray[np.float64]

UNITS = {"position": (1e3, "mm"), "yaw": (DEGREES, "°"), "wheel_speed": (1e3, "mm/s"),
         "yaw_rate": (DEGREES, "°/s")}  # fmt: skip
POINTS_MAX = 1500


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


def draw_residuals(found: Fit) -> str:
    """Residuals of each kind over time, and their spread against the signal's own noise."""
    left = found.residuals
    present = [int(g) for g in np.unique(left.group)]
    axes = make_axes(2 * len(present), 1.7)
    for over, spread, group in zip(axes[::2], axes[1::2], present, strict=True):
        mine = left.group == group
        scale, unit = UNITS[GROUPS[group]]
        values = scale * left.error[mine]
        step = max(1, len(values) // POINTS_MAX)
        over.plot(left.t[mine][::step], values[::step], ".", ms=1.2, color=AFTER)
        over.set_xlabel("time into each drive [s]")
        over.set_ylabel(f"{GROUPS[group]} [{unit}]".replace("_", " "))
        edge = max(4.0 * float(np.sqrt(np.mean(values**2))), 1e-6)
        bins = np.linspace(-edge, edge, 60)
        spread.hist(values, bins, color=AFTER, alpha=0.7, density=True)
        sigma = scale * float(left.signal[group])
        bell = np.exp(-0.5 * (bins / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
        spread.plot(bins, bell, color=INK, lw=1.0)
    axes[0].set_title("residuals of the fit")
    axes[1].set_title("their spread; the line is the instrument's own noise")
    return to_svg(axes)


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


def draw_profiles(profiles: Sequence[Profile]) -> str:
    """Lateral and heading error of each design, a column a floor."""
    names = list(dict.fromkeys(profile.design for profile in profiles))
    axes = make_axes(2 * len(FRICTIONS), 2.2)
    colours = dict(zip(names, (INK, AFTER, BEFORE), strict=False))
    for column, floor in enumerate(FRICTIONS):
        e1, e2 = axes[column :: len(FRICTIONS)]
        for profile in (p for p in profiles if p.friction == floor):
            t, off, turned = profile.rows.T
            e1.plot(t, 1e3 * off, color=colours[profile.design], lw=1.1)
            e2.plot(t, np.degrees(turned), color=colours[profile.design], lw=1.1)
        e1.set(title=f"e1 [mm], {floor} friction", xlabel="time [s]")
        e2.set(title=f"e2 [°], {floor} friction", xlabel="time [s]")
    return to_svg(axes, {f"designed from {name}": colour for name, colour in colours.items()})
