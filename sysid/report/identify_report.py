"""The report of `steerd identify`: one HTML file without links, results first."""

from collections.abc import Iterator
from math import degrees, isnan
from pathlib import Path
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.sysid.estimation.outcome import Outcome
from steerd.sysid.report import identify_figures as figures
from steerd.sysid.report.design_comparison import Profile, compare_designs
from steerd.sysid.report.page import render_page

IMPROVEMENT_MIN = 1.02
"""A smaller factor is no improvement."""
TEMPLATE = Path(__file__).parent / "templates" / "report.html"


class Section(NamedTuple):
    """A headed figure with a sentence about it."""

    title: str
    text: str
    figure: str


def render_report(outcome: Outcome) -> str:
    """The whole page."""
    profiles = compare_designs(*_designs(outcome))
    return render_page(
        TEMPLATE,
        outcome=outcome,
        headline=_headline(outcome),
        rows=outcome.free_rows,
        fixed={name: row for name, row in outcome.rows.items() if not row.free},
        degrees=degrees,
        isnan=isnan,
        truth=outcome.truth._asdict() if outcome.truth is not None else None,
        sections=list(_sections(outcome, profiles)),
    )


def _designs(outcome: Outcome) -> tuple[Car[float], dict[str, Car[float]]]:
    """The plant, and the cars that controllers are designed from."""
    designs = {"identified": outcome.after, "start values": outcome.before}
    if outcome.truth is None:
        return outcome.after, designs
    return outcome.truth, {"truth": outcome.truth, **designs}


def _headline(outcome: Outcome) -> str:
    """The results in two sentences."""
    free = list(outcome.free_rows.values())
    count = sum(row.identifiable for row in free)
    text = f"{count} of {len(free)} free parameters are identifiable from these data."
    known = [h for h in outcome.held_out if not isnan(h.after.position)]
    if not known:
        return text
    last = known[-1]
    change = "no improvement"
    if last.factor >= IMPROVEMENT_MIN:
        change = f"the error falls by a factor of {last.factor:.1f}"
    after, before = last.after, last.before
    against = f"start values: {before.position * 1e3:.1f} mm"
    return (
        f"{text} On drives that were not fitted, predictions {after.horizon:g} s ahead are off "
        f"by {after.position * 1e3:.1f} mm and {degrees(after.heading):.2f}° "
        f"({against}): {change}."
    )


def _sections(outcome: Outcome, profiles: tuple[Profile, ...]) -> Iterator[Section]:
    yield Section(
        "Prediction of drives that were not fitted",
        f"Validated on {outcome.held_out_of}. Open loop: the state is fitted to the 0.4 s before, "
        "then only the commands are known.",
        figures.draw_held_out(outcome.held_out),
    )
    yield Section("", "", figures.draw_traces(outcome.traces))
    plant = "the identified car" if outcome.truth is None else "the true (simulated) car"
    yield Section(
        "Lane keeping with controllers designed from these parameters",
        f"A figure eight at up to 2 m/s from 0.15 m beside it, on {plant}. {_closed(profiles)}",
        figures.draw_profiles(profiles),
    )
    if outcome.fit is not None:
        yield Section(
            "Residuals",
            "Flat and as narrow as the line: the model explains the drive. Waves or a wide "
            "spread: something is missing, and steerd diagnose looks for it.",
            figures.draw_residuals(outcome.fit),
        )
        yield Section(
            "Correlation of the estimates",
            "Near ±1: the data identify the combination, not its members.",
            figures.draw_correlation(outcome.fit),
        )
    if outcome.searches:
        yield Section(
            "Convergence",
            "Parameters that stay near their starts do not change the loss: "
            "they are not identifiable.",
            figures.draw_searches(outcome.searches),
        )


def _closed(profiles: tuple[Profile, ...]) -> str:
    parts = []
    for p in profiles:
        result = f"refused ({p.refused})" if p.refused else f"{p.rms * 1e3:.1f} mm"
        parts.append(f"{p.design}, {p.friction} friction: {result}")
    return "RMS of e1: " + "; ".join(parts) + "."
