"""The gap report's figures as inline SVG, styled as those of the identification."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.lane_comparison import (
    LaneComparison,
    LaneDrive,
    as_long,
    profile,
    steering_spectrum,
)
from steerd.sim_gap.verdict.shrinkage import Shrinkage
from steerd.sim_gap.verdict.where import EQUATIONS, Regime, Where, range_words
from steerd.sysid.report.drawing import (
    AFTER,
    BAND,
    BEFORE,
    CONFOUNDED,
    FAINT,
    INK,
    MEASURED,
    Diagrams,
    plain_log,
    scale_bars,
)
from steerd.sysid.report.report import DEGREES

_KINDS = (
    ("position", "position [mm]", 1e3), ("yaw", "heading [°]", DEGREES),
    ("speed", "wheel speed [mm/s]", 1e3),
)  # fmt: skip
"""Errors that are drawn, with their labels and scales."""
SHOWN_MOST, RUNS_MOST = 12, 4  # candidates and drives that are drawn; the rest is in the JSON


def _name_rows(axis: Axes, labels: Sequence[str]) -> None:
    """Names at the left, the first on top."""
    axis.set_yticks(range(len(labels)), labels)
    axis.set_ylim(len(labels) - 0.4, -0.6)


def draw_main(found: Diagnosis) -> list[Diagrams]:
    """The gap, the candidates and the gap over time: what is drawn of every diagnosis."""
    colours = {"base car": BEFORE, **({"with the effect": AFTER} if found.causes else {})}
    errors = found.before.errors
    measured = [kind for kind in _KINDS if any(getattr(lead, kind[0]).value for lead in errors)]
    measured = measured or [*_KINDS[:1]]
    rows = min(len(found.candidates) + 1, SHOWN_MOST)
    runs = list(dict.fromkeys(found.timeline.run))[:RUNS_MOST]
    named = {"named": AFTER} if found.causes else {}
    if any(cause.ambiguous_with for cause in found.causes):
        named["may be it instead"] = CONFOUNDED
    wide, height = max(len(measured), 2), 0.7 + 0.24 * max(rows, 2)
    named |= {"others": FAINT} if named else {}
    gap = partial(_plot_gap, found=found, measured=measured)
    timeline = partial(_plot_timeline, found=found, runs=runs)
    return [
        Diagrams(gap, 2.5, count=len(measured), columns=wide, colours=colours),
        Diagrams(_plot_candidates, height, [found], colours=named),
        Diagrams(timeline, 1.9, count=len(runs), colours=colours),
    ]


def _plot_gap(*axes: Axes, found: Diagnosis, measured: Sequence[tuple[str, str, float]]) -> None:
    """Error after each lead with 90 % intervals: position, heading, wheel speed, as measured."""
    pairs, explained = found.leads, bool(found.causes)
    for axis, (name, label, scale) in zip(axes, measured, strict=True):
        heights: list[float] = []
        for side, shift, colour in ((0, -0.2, BEFORE), (1, 0.2, AFTER))[: 1 + explained]:
            errors = np.array([getattr(pair[side], name) for pair in pairs]).reshape(-1, 3)
            value, low, high = scale * errors.T
            axis.bar(
                np.arange(len(pairs)) + shift * explained, value, 0.36, color=colour,
                yerr=np.clip([value - low, high - value], 0.0, None),
                error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2.0},
            )  # fmt: skip
            heights += [*value, *high]
        axis.set_xticks(range(len(pairs)), [f"{before.seconds:g} s" for before, _ in pairs])
        axis.set_title(label)
        scale_bars(axis, heights)
        axis.grid(visible=False, axis="x")
    axes[0].set_ylabel("root mean square")


def _plot_candidates(axis: Axes, found: Diagnosis) -> None:
    """Posterior probability of each hypothesis, something else among them."""
    none = "no gap" if found.verdict == "none" else "something else"
    rows = [(name, p) for name, p, _ in found.candidates] + [(none, found.something_else)]
    rows = sorted(rows, key=lambda row: -row[1])[:SHOWN_MOST]
    names = {cause.effect for cause in found.causes}
    confounded = {other for cause in found.causes for other in cause.ambiguous_with}
    for place, (effect, probability) in enumerate(rows):
        parts = set(effect.split("+"))
        chosen = bool(names) and parts == names
        colour = AFTER if chosen else CONFOUNDED if parts & confounded else FAINT
        axis.barh(place, 100.0 * probability, 0.66, color=colour)
        axis.text(100.0 * probability + 1.0, place, f"{probability:.0%}", va="center", fontsize=8)
    _name_rows(axis, [row[0].replace("+", " + ") for row in rows])
    axis.set_xlim(0.0, 112.0)
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("posterior probability [%]")


def plot_where(left: Axes, right: Axes, where: Where) -> None:
    """Shares by equation and by measured channel."""
    _shares(left, [(EQUATIONS[s.name], s.share) for s in where.equation])
    left.set_title("hidden input that would remove the error")
    shown = [s for s in where.channels if s.share > 5e-3] or where.channels[:1]
    _shares(right, [(s.name.replace("_", " "), s.share) for s in shown])
    right.set_title("measurement in which it shows")


def _shares(axis: Axes, rows: Sequence[tuple[str, float]]) -> None:
    shares = [share for _, share in rows]
    colours = [AFTER if share == max(shares) else FAINT for share in shares]
    axis.barh(range(len(shares)), [100.0 * s for s in shares], 0.66, color=colours)
    for place, share in enumerate(shares):
        axis.text(100.0 * share + 1.0, place, f"{share:.0%}", va="center", fontsize=8)
    _name_rows(axis, [label for label, _ in rows])
    axis.set(xlim=(0.0, 112.0), xlabel="share [%]")
    axis.set_xticks([0, 25, 50, 75, 100])
    axis.grid(visible=False, axis="y")


def _plot_timeline(*axes: Axes, found: Diagnosis, runs: Sequence[str]) -> None:
    """Whitened error of each window over its drive's time; stretches that stand out are shaded."""
    line, shown = found.timeline, [(found.timeline.before, BEFORE)]
    shown += [(found.timeline.after, AFTER)] if found.causes else []
    for axis, run in zip(axes, runs, strict=True):
        mine = np.array([name == run for name in line.run])
        for stretch in found.where.windows:
            if stretch.run == run:
                axis.axvspan(stretch.t0, stretch.t1, color=BAND, lw=0)
        for values, colour in shown:
            height = np.clip(values[mine], 1e-2, 1e5)
            axis.hlines(height, line.t0[mine], line.t1[mine], color=colour, lw=2.0)
        axis.axhline(1.0, color=INK, lw=0.8, ls=":")
        axis.set(yscale="log", ylabel="error / noise", title=run, xlabel="time into the drive [s]")
        plain_log(axis.yaxis)


def plot_regimes(axis: Axes, rows: Sequence[Regime]) -> None:
    """How much larger the error is in each regime of driving than elsewhere."""
    for place, r in enumerate(rows):
        colour = AFTER if r.ratio_low > 1.0 else FAINT
        ratio = max(r.ratio, 1e-3)
        axis.plot([max(r.ratio_low, 1e-3), max(r.ratio_high, 1e-3)], [place, place],
                  color=colour, lw=2.0)  # fmt: skip
        axis.plot(ratio, place, "o", color=colour)
    _name_rows(axis, [f"{r.variable.replace('_', ' ')} {range_words(r)}" for r in rows])
    axis.axvline(1.0, color=INK, lw=0.8, ls=":")
    axis.set(xscale="log", xlabel="error there / elsewhere")
    plain_log(axis.xaxis)
    ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000)
             if axis.get_xlim()[0] <= t <= axis.get_xlim()[1]]  # fmt: skip
    axis.set_xticks(ticks, [f"{t:g}" for t in ticks])


def plot_shrinkage(axis: Axes, s: Shrinkage) -> None:
    """Predicted share of the excess error, with its interval, against what was measured."""
    axis.plot([100 * s.low, 100 * s.high], [0, 0], color=BEFORE, lw=6.0, alpha=0.4,
              solid_capstyle="butt")  # fmt: skip
    axis.plot(100 * s.predicted, 0, "o", color=BEFORE, ms=8)
    labels = ["predicted"]
    if s.measured is not None:
        axis.plot(100 * s.measured, 1, "D", color=AFTER, ms=8)
        labels.append("measured")
    _name_rows(axis, labels)
    axis.set(xlim=(-2.0, 104.0), xlabel="excess error removed [%]; 100 leaves noise alone")


def draw_lane(lane: LaneComparison) -> Diagrams:
    """e1 and e2 along the lane, and the steering's spectrum: recorded and simulated."""
    rows = (
        (lane.recorded, MEASURED, "recorded"),
        (lane.without, BEFORE, "simulated, base car"),
        (lane.with_effect, AFTER, "simulated, with the effect"),
    )
    drives = [(drive, colour) for drive, colour, _ in rows if drive is not None]
    colours = {name: colour for drive, colour, name in rows if drive is not None}
    return Diagrams(_plot_lane, 3.0, (lane, drives), 3, 3, colours)


def _plot_lane(
    e1: Axes, e2: Axes, steer: Axes, lane: LaneComparison, drives: Sequence[tuple[LaneDrive, str]]
) -> None:
    for drive, colour in drives:
        width, alpha = (2.4, 0.45) if drive is lane.recorded else (1.3, 1.0)
        for axis, field, scale in ((e1, "e1", 1e3), (e2, "e2", DEGREES)):
            means = profile(drive.s, drive.length, getattr(drive, field))
            at = (np.arange(len(means)) + 0.5) / len(means) * drive.length
            axis.plot(at, scale * means, color=colour, lw=width, alpha=alpha)
        shown = drive if lane.without is None else as_long(drive, lane.without)
        f, density = steering_spectrum(shown)
        steer.plot(f, DEGREES * density, color=colour, lw=width, alpha=alpha)
    e1.set(xlabel="along the lane [m]", title="lateral offset e1 [mm]")
    e2.set(xlabel="along the lane [m]", title="heading error e2 [°]")
    steer.set(xlabel="frequency [Hz]", yscale="log", xscale="log",
                   title="steering spectrum [°/√Hz]")  # fmt: skip
    plain_log(steer.xaxis)
    steer.set_xticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
    plain_log(steer.yaxis)
