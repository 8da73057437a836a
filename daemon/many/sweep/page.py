"""The page of `steerd sweep`: one HTML file without links."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes

from steerd.daemon.common.screen import clean
from steerd.daemon.many.sweep.distributions import Distribution
from steerd.daemon.many.sweep.measures import DRIVEN, MEASURES, STOPPED
from steerd.daemon.many.sweep.plan import Choice
from steerd.daemon.many.sweep.summary import STOPS, Sensitivity, Summary, SweptDrives, column
from steerd.daemon.many.sweep.text import SCALES, show_unit, show_value
from steerd.sysid.report.drawing import AFTER, BEFORE, STYLE, make_figure, to_svg
from steerd.sysid.report.page import render_page

TEMPLATE = Path(__file__).parent / "templates" / "sweep.html"
_COLUMNS = 3
"""Small figures side by side."""
_BINS = 30
_TICKS = 5
"""Numbers below a small diagram at most: more would touch."""
_SCATTERS = 6
"""Strongest dependences that are drawn."""
_POINTS = 1500
"""Points of a scatter figure; more make a page heavy and show no more."""
_VALUES = 6
"""Values of a list that are shown."""
_UNITS = {c.name: c.unit for c in MEASURES}


def render_sweep(found: SweptDrives) -> str:
    """The whole page."""
    plan, summary = found.plan, found.summary
    with rc_context(STYLE):
        histograms, scatters = _draw_histograms(found), _draw_scatters(found)
    heads = [*dict.fromkeys(s.quantity for s in summary.sensitivities)]
    seeds = f"{len(plan.seeds)} seeds, {plan.duration:g} s each, loop at {plan.rate:g} Hz"
    fixed = [] if "path" in plan.vary else [plan.path]
    fixed += [] if "speed" in plan.vary else [f"{plan.speed:g} m/s"]
    return render_page(
        TEMPLATE,
        count=len(found.rows),
        headline=_headline(summary),
        facts="; ".join([clean(plan.car.name), seeds, *fixed]),
        ends=list(_ends(summary)),
        varied=[_varied(found, name, choice) for name, choice in plan.vary.items()],
        spreads=list(_spreads(summary)),
        histograms=histograms,
        heads=heads,
        moves=list(_moves(summary, heads)),
        scatters=scatters,
    )


def _headline(summary: Summary) -> str:
    """The result in a sentence or two."""
    shares = {share.name: share for share in summary.outcomes}
    driven, stopped = shares[DRIVEN], shares[STOPPED]
    text = f"{driven.value:.1%} of the drives ended as planned"
    text += f", a watchdog stopped {stopped.value:.1%}." if stopped.count else "."
    for s in summary.spreads:
        if s.name == "true_e1_max":
            text += f" In 95 % of them the car stays within {1e3 * s.high:.0f} mm of its lane."
    return text


def _ends(summary: Summary) -> Iterator[list[str]]:
    named = [(share.name, share) for share in summary.outcomes if share.count]
    named += [(f"by {clean(share.name, 12)}", share) for share in summary.watchdogs]
    for name, share in named:
        between = f"{share.low:.1%} to {share.high:.1%}"
        yield [name, str(share.count), f"{share.value:.1%}", between]


def _varied(found: SweptDrives, name: str, choice: Choice) -> list[str]:
    quantity = next(q for q in found.plan.quantities if q.name == name)
    return [name, _describe(choice), quantity.unit, quantity.meaning]


def _describe(choice: Choice) -> str:
    """A list or a distribution in a few words."""
    if not isinstance(choice, Distribution):
        shown = ", ".join(clean(str(value), 24) for value in choice[:_VALUES])
        return shown + (", …" if len(choice) > _VALUES else "")
    one, other = f"{choice.one:.4g}", f"{choice.other:.4g}"
    match choice.shape:
        case "normal":
            return f"{one} ± {other}"
        case "log_normal":
            return f"{one}, factor {other}"
        case shape:
            return f"{one} to {other}" + (" (logarithmic)" if shape == "log_uniform" else "")


def _spreads(summary: Summary) -> Iterator[list[str]]:
    for s in summary.spreads:
        unit = show_unit(s.unit)
        label = f"{s.name} [{unit}]" if unit else s.name
        values = (s.low, s.middle, s.high, s.worst)
        yield [label, *(show_value(value, s.unit) for value in values), str(s.worst_drive)]


def _moves(summary: Summary, heads: Sequence[str]) -> Iterator[tuple[str, list[tuple[str, bool]]]]:
    """A row for each measure: there are more measures than quantities, and pages are narrow."""
    found = {(s.quantity, s.measure): s for s in summary.sensitivities}
    for name in dict.fromkeys(s.measure for s in summary.sensitivities):
        cells = [found.get((head, name)) for head in heads]
        yield name, [("–", False) if s is None else (f"{s.value:+.2f}", s.shown) for s in cells]


def _scaled(rows: Sequence[Mapping[str, Any]], name: str) -> np.ndarray:
    return column(rows, name) * SCALES.get(_UNITS.get(name, ""), (1.0, ""))[0]


def _label(name: str) -> str:
    unit = show_unit(_UNITS.get(name, ""))
    return f"{name} [{unit}]" if unit else name


def _draw_histograms(found: SweptDrives) -> str:
    """How often each measure takes which value."""
    names = [spread.name for spread in found.summary.spreads]
    if not names:
        return ""
    count = -(-len(names) // _COLUMNS)
    figure, axes = make_figure(count, _COLUMNS, 1.9 * count)
    for axis in axes.flat[len(names) :]:
        axis.set_visible(False)
    for axis, name in zip(axes.flat, names, strict=False):
        values = _scaled(found.rows, name)
        axis.hist(values[np.isfinite(values)], bins=_BINS, color=BEFORE)
        axis.locator_params(axis="x", nbins=_TICKS)
        axis.set_title(_label(name))
        axis.set_ylabel("drives")
        axis.yaxis.get_major_locator().set_params(integer=True)
    return to_svg(figure, "How often each measure takes which value")


def _draw_scatters(found: SweptDrives) -> str:
    """The strongest dependences, a point for each drive."""
    varied = {q.name: q for q in found.plan.quantities}
    strong = [s for s in found.summary.sensitivities if s.shown and s.measure != STOPS]
    strong.sort(key=lambda s: -abs(s.value))
    del strong[_SCATTERS:]
    if not strong:
        return ""
    count = -(-len(strong) // _COLUMNS)
    figure, axes = make_figure(count, _COLUMNS, 2.4 * count)
    for axis in axes.flat[len(strong) :]:
        axis.set_visible(False)
    for axis, s in zip(axes.flat, strong, strict=False):
        _draw_scatter(axis, found.rows[: None if len(found.rows) < _POINTS else _POINTS], s)
        unit = varied[s.quantity].unit
        axis.set_xlabel(f"{s.quantity} [{unit}]" if unit not in ("", "1") else s.quantity)
        axis.set_ylabel(_label(s.measure))
    return to_svg(figure, "The strongest dependences, a point for each drive")


def _draw_scatter(axis: Axes, rows: Sequence[Mapping[str, Any]], s: Sensitivity) -> None:
    values = _scaled(rows, s.measure)
    given = [row[s.quantity] for row in rows]
    if any(isinstance(value, str) for value in given):
        names = sorted({str(value) for value in given})
        axis.set_xticks(range(len(names)), [clean(name, 14) for name in names])
        given = [names.index(str(value)) for value in given]
    axis.plot(given, values, ".", ms=2.5, color=AFTER, alpha=0.6)
