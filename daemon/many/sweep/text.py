"""The screen of `steerd sweep`, and the tables that it shares with the page."""

from collections.abc import Mapping, Sequence
from typing import Any

from steerd.daemon.common.screen import clean, wrap
from steerd.daemon.many.sweep.measures import DRIVEN, MEASURES
from steerd.daemon.many.sweep.plan import SweepPlan
from steerd.daemon.many.sweep.summary import Sensitivity, Summary
from steerd.sysid.report.report import SCALES, Table, format_table

UNITS = {c.name: c.unit for c in MEASURES}
"""SI unit by measure."""
_SHOWN = 8
"""Dependences that are shown."""


def describe_sweep(
    plan: SweepPlan, rows: Sequence[Mapping[str, Any]], summary: Summary, speed: float | None
) -> str:
    """The screen: how it ended, what moved what; `speed` is that of the simulation, if known."""
    varied = ", ".join(plan.vary) or "nothing but the seeds"
    seconds = sum(row.get("seconds") or 0.0 for row in rows)
    lines = [f"drives     {len(rows)} of {plan.duration:g} s, {seconds:.0f} s driven"]
    lines += wrap(varied, "varied     ", " " * 11)
    if speed is not None:
        lines.append(f"speed      {speed:.0f} x real time")
    parts = [tabulate_ends(summary), tabulate_spreads(summary)]
    strong = list_strongest(summary)[:_SHOWN]
    if strong:
        found = [
            (s.quantity, name_measure(s.measure), *_ends(s), f"{s.value:+.2f}") for s in strong
        ]
        heads = ("what moves", "what", "from", "to", "rank correlation")
        parts.append(Table(heads, found, words=(1,)))
    return "\n".join([*lines, *(line for part in parts for line in ("", *format_table(part)))])


def tabulate_ends(summary: Summary) -> Table:
    """How often drives ended in which way."""
    named = [(s.name, s) for s in summary.outcomes if s.count or s.name == DRIVEN]
    named += [(f"by {clean(s.name, 12)}", s) for s in summary.watchdogs]
    rows = [
        (name, str(s.count), f"{s.value:.1%}", f"{s.low:.1%} to {s.high:.1%}") for name, s in named
    ]
    return Table(("outcome", "drives", "share", "95 % interval"), rows)


def tabulate_spreads(summary: Summary) -> Table:
    """The distribution of each measure."""
    rows = []
    for s in summary.spreads:
        factor, _ = SCALES.get(s.unit, (1.0, ""))
        figures = (f"{value * factor:.3g}" for value in (s.low, s.middle, s.high, s.worst))
        rows.append((name_measure(s.name), *figures, str(s.worst_drive)))
    return Table(("measure", "5 %", "median", "95 %", "worst", "in drive"), rows)


def list_strongest(summary: Summary) -> list[Sensitivity]:
    """Dependences that the drives show, by how far the measure moves."""
    return sorted((s for s in summary.sensitivities if s.shown), key=lambda s: -s.size)


def _ends(s: Sensitivity) -> tuple[str, str]:
    """What the measure is for low and for high values of the quantity."""
    factor, _ = SCALES.get(UNITS.get(s.measure, ""), (1.0, ""))
    return f"{factor * s.start:.3g}", f"{factor * s.end:.3g}"


def name_measure(name: str) -> str:
    """A measure with the unit that people read."""
    unit = UNITS.get(name, "")
    unit = SCALES.get(unit, (1.0, "" if unit == "1" else unit))[1]
    return f"{name} [{unit}]" if unit else name
