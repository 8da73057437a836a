"""The page of `steerd sweep`: one HTML file without links."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes

from steerd.daemon.common.screen import clean
from steerd.daemon.many.sweep import summary as figures
from steerd.daemon.many.sweep.plan import DRIVEN, Choice, Distribution
from steerd.daemon.many.sweep.summary import Summary
from steerd.sysid.report.drawing import AFTER, BEFORE, Diagrams
from steerd.sysid.report.report import Card, Cell, Report, Section, Table

_BINS = 30
_TICKS = 5  # numbers below a small diagram at most: more would touch
_SCATTERS = 6  # strongest dependences that are drawn
_POINTS = 1500  # points of a scatter figure; more make a page heavy and show no more
_MOVED = 0.01
"""A measure that moves less is moved by nothing that matters: damping by its fourth digit."""
_VALUES = 6  # values of a list that are shown


def make_report(found: Summary) -> Report:
    """The page: distributions, stops, sensitivity of each to each."""
    plan = found.plan
    fixed = [] if "path" in plan.vary else [plan.path]
    fixed += [] if "speed" in plan.vary else [f"{plan.speed:g} m/s"]
    seeds = f"{len(plan.seeds)} seeds, {plan.duration:g} s each, loop at {plan.rate:g} Hz"
    varied = [
        (q.name, _describe(plan.vary[q.name]), q.unit if q.unit != "1" else "", q.meaning)
        for q in plan.quantities
    ]
    sections = [
        Section("How they ended", table=found.tabulate_ends()),
        Section(
            "What was varied",
            table=Table(("quantity", "values", "unit", "meaning"), varied, words=(1, 3)),
        ),
        Section(
            "Distributions",
            "Errors count after the first 3 s. The last column is the drive to look at: `steerd "
            "sweep FILE.toml` `--again N` `--record drive.mcap` drives it once more and records "
            "it.",
            table=found.tabulate_spreads(),
            figures=_draw_histograms(found),
        ),
    ]
    if found.sensitivities:
        sections.append(Section(
            "What moves what",
            "Rank correlation of each varied quantity with each measure, from −1 to 1; a list of "
            "texts has no sign. Bold: more than chance alone shows in one case of twenty, and the "
            f"measure moves by more than {_MOVED:.0%}.",
            table=_moves(found),
            figures=_draw_scatters(found),
        ))  # fmt: skip
    return Report(
        title=f"{len(found.rows)} drives, each another draw",
        subject=clean(plan.car.name),
        about="; ".join([seeds, *fixed]),
        sections=sections,
        foot="Written by steerd sweep. Simulated drives in virtual time; both ends of VESC and "
        "mocap are encoded and parsed as on a car.",
        cards=list(_cards(found)),
    )


def _cards(found: Summary) -> Iterator[Card]:
    """The figures that are read first."""
    driven = next(share for share in found.outcomes if share.name == DRIVEN)
    stops = sum(share.count for share in found.watchdogs)
    text = f"{driven.count} of {driven.of} drives; a watchdog stopped {stops}"
    yield Card("ended as planned", f"{driven.value:.1%}", text)
    for s in found.spreads:
        if s.name.startswith("true_e1_"):
            text = f"in 95 % of the drives; the worst is drive {s.worst_drive}"
            yield Card(f"{s.name.removeprefix('true_')} below", f"{1e3 * s.high:.3g} mm", text)
    for move in found.list_strongest()[:1]:
        yield Card(
            "moves most", move.quantity, f"{move.measure}, rank correlation {move.value:+.2f}"
        )


def _moves(found: Summary) -> Table:
    """A row for each measure: there are more measures than quantities, and pages are narrow."""
    heads = [*dict.fromkeys(s.quantity for s in found.sensitivities)]
    cells = {(s.quantity, s.measure): s for s in found.sensitivities}
    rows: list[list[str | Cell]] = []
    for name in dict.fromkeys(s.measure for s in found.sensitivities):
        rows.append([name])
        for s in (cells.get((head, name)) for head in heads):
            strong = s is not None and s.shown and s.size > _MOVED
            text = f"{s.value:+.2f}" if s is not None else "–"
            rows[-1].append(Cell(text, "strong" if strong else "quiet"))
    return Table(["measure", *heads], rows)


def _describe(choice: Choice) -> str:
    if isinstance(choice, Distribution):
        return str(choice)
    shown = ", ".join(clean(str(value), 24) for value in choice[:_VALUES])
    return shown + (", …" if len(choice) > _VALUES else "")


def _draw_histograms(found: Summary) -> list[Diagrams]:
    """How often each measure takes which value."""
    names = [spread.name for spread in found.spreads]

    def plot(*axes: Axes) -> None:
        for axis, name in zip(axes, names, strict=True):
            factor, label = figures.find_scale(name)
            values = factor * figures.column(found.rows, name)
            axis.hist(values[np.isfinite(values)], bins=_BINS, color=BEFORE)
            axis.locator_params(axis="x", nbins=_TICKS)
            axis.set(title=label, ylabel="drives")
            axis.locator_params(axis="y", integer=True)

    return [Diagrams(plot, 1.9, count=len(names), columns=3)] if names else []


def _draw_scatters(found: Summary) -> list[Diagrams]:
    """The strongest dependences, a point for each drive."""
    units = {q.name: q.unit for q in found.plan.quantities}
    strong = [s for s in found.list_strongest() if s.measure != figures.STOPS][:_SCATTERS]

    def plot(*axes: Axes) -> None:
        for axis, s in zip(axes, strong, strict=True):
            given = [row[s.quantity] for row in found.rows[:_POINTS]]
            if any(isinstance(value, str) for value in given):
                names = sorted({str(value) for value in given})
                axis.set_xticks(range(len(names)), [clean(name, 14) for name in names])
                given = [names.index(str(value)) for value in given]
            factor, label = figures.find_scale(s.measure)
            seen = factor * figures.column(found.rows[:_POINTS], s.measure)
            axis.plot(given, seen, ".", ms=2.5, color=AFTER, alpha=0.6)
            unit = units[s.quantity]
            axis.set_xlabel(f"{s.quantity} [{unit}]" if unit not in ("", "1") else s.quantity)
            axis.set_ylabel(label)

    return [Diagrams(plot, 2.4, count=len(strong), columns=3)] if strong else []
