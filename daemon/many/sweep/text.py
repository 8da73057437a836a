"""The screen of `steerd sweep`."""

from collections.abc import Iterator

from steerd.daemon.common.screen import clean, wrap
from steerd.daemon.many.sweep.measures import DRIVEN
from steerd.daemon.many.sweep.summary import Spread, Summary, SweptDrives

SCALES = {"m": (1e3, "mm"), "s": (1e3, "ms"), "rad": (57.29577951308232, "deg")}
"""Unit that people read, by the SI unit: factor and name."""
_SHOWN = 8


def show_value(value: float, unit: str) -> str:
    """A figure in the unit that people read."""
    factor, _ = SCALES.get(unit, (1.0, unit))
    return f"{value * factor:.3g}"


def show_unit(unit: str) -> str:
    """The unit that people read; nothing for none."""
    return SCALES.get(unit, (1.0, "" if unit == "1" else unit))[1]


def describe_sweep(found: SweptDrives) -> str:
    """The screen: how it ended, what moved what."""
    plan, summary = found.plan, found.summary
    varied = ", ".join(plan.vary) or "nothing but the seeds"
    seconds = sum(row.get("seconds") or 0.0 for row in found.rows)
    lines = [f"drives     {len(found.rows)} of {plan.duration:g} s, {seconds:.0f} s driven"]
    lines += wrap(varied, "varied     ", " " * 11)
    if found.driven and found.wall > 0.0:
        share = found.driven / len(found.rows)
        lines.append(f"speed      {seconds * share / found.wall:.0f} x real time")
    lines += ["", *_ends(summary), "", *_spreads(summary.spreads)]
    moved = list(_moved(summary))
    return "\n".join([*lines, *(["", *moved] if moved else [])])


def _ends(summary: Summary) -> Iterator[str]:
    for share in summary.outcomes:
        if share.count or share.name == DRIVEN:
            between = f"({share.low:.1%} to {share.high:.1%})"
            yield f"{share.name:<10} {share.count:>6}  {share.value:>6.1%}  {between}"
    for share in summary.watchdogs:
        yield f"  by {clean(share.name, 10):<6} {share.count:>5}  {share.value:>6.1%}"


def _spreads(spreads: tuple[Spread, ...]) -> Iterator[str]:
    yield f"{'':<22}{'5 %':>9}{'median':>9}{'95 %':>9}{'worst':>9}  in drive"
    for s in spreads:
        label = f"{s.name} {show_unit(s.unit)}".rstrip()
        cells = "".join(f"{show_value(v, s.unit):>9}" for v in (s.low, s.middle, s.high, s.worst))
        yield f"{label:<22}{cells}  {s.worst_drive}"


def _moved(summary: Summary) -> Iterator[str]:
    """The strongest dependences."""
    strong = sorted((s for s in summary.sensitivities if s.shown), key=lambda s: -abs(s.value))
    if strong:
        yield "what moves what (rank correlation)"
    for s in strong[:_SHOWN]:
        yield f"  {s.quantity:<30} {s.measure:<14} {s.value:+.2f}"
