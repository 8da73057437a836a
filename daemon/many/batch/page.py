"""The page of `steerd batch`: quantities over weeks, car by car, and the days of changes."""

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes

from steerd.daemon.common.screen import clean
from steerd.daemon.many.batch.changes import Change, Series, WorkedSessions, make_band, split_series
from steerd.daemon.many.batch.text import nothing_changed
from steerd.sysid.report.drawing import AFTER, BAND, BEFORE, STYLE, make_figure, to_svg
from steerd.sysid.report.page import render_page

TEMPLATE = Path(__file__).parent / "templates" / "batch.html"
_COLUMNS, _DAY = 3, 86_400.0
_FIGURES = 30
"""Series that are drawn: those that changed first; more make a page nobody looks through."""
_FAILURES = 20
_LEAST_SHARE = 0.01
"""Least height of a diagram, as a share of what it shows."""


def render_batch(found: WorkedSessions) -> str:
    """The whole page."""
    first: dict[tuple[str, str], Change] = {(c.car, c.quantity): c for c in found.changes}
    ordered = sorted(found.series, key=lambda s: (s.car, s.quantity) not in first)
    with rc_context(STYLE):
        figure = _draw(ordered[:_FIGURES], first) if ordered else ""
    rows = found.rows
    failed = [row for row in rows if row["outcome"] != "done"]
    return render_page(
        TEMPLATE,
        kind=found.kind,
        count=len(rows),
        headline=_headline(found),
        cars=_count_cars(found),
        changes=[_describe(change) for change in found.changes],
        failed=[(clean(str(row["session"]), 60), clean(row["failure"])) for row in failed],
        failures=_FAILURES,
        figure=figure,
        drawn=len(ordered[:_FIGURES]),
        series=len(ordered),
    )


def _headline(found: WorkedSessions) -> str:
    """The result in a sentence."""
    clearest: dict[str, Change] = {}
    for change in found.changes:
        clearest.setdefault(change.car, change)
    if not clearest:
        why = nothing_changed(found)
        return f"{why[0].upper()}{why[1:]}."
    parts = [f"{clean(c.car, 24)} since {c.day} ({c.quantity})" for c in clearest.values()]
    return f"Changed: {', '.join(parts)}."


def _count_cars(found: WorkedSessions) -> list[tuple[str, int, int, str, str]]:
    """Each car's sessions, failures and days."""
    counts = Counter(str(row.get("car") or "?") for row in found.rows)
    table = []
    for car, count in sorted(counts.items()):
        own = [row for row in found.rows if str(row.get("car") or "?") == car]
        days = sorted(row["day"] for row in own if row.get("day")) or ["–"]
        failed = sum(row["outcome"] != "done" for row in own)
        table.append((clean(car, 24), count, failed, days[0], days[-1]))
    return table


def _describe(change: Change) -> list[str]:
    between = change.day
    if change.earliest != change.latest:
        between = f"{change.day} ({change.earliest} to {change.latest})"
    return [
        clean(change.car, 24), change.quantity, between, f"{change.before:.4g}",
        f"{change.after:.4g}", f"{change.sd:.2g}", f"{change.sigmas:.0f}",
    ]  # fmt: skip


def _draw(series: Sequence[Series], changes: dict[tuple[str, str], Change]) -> str:
    """A small figure for each series."""
    count = -(-len(series) // _COLUMNS)
    figure, axes = make_figure(count, _COLUMNS, 2.0 * count)
    for axis in axes.flat[len(series) :]:
        axis.set_visible(False)
    for axis, s in zip(axes.flat, series, strict=False):
        _draw_series(axis, s, changes.get((s.car, s.quantity)))
    return to_svg(figure, "Quantities over time")


def _draw_series(axis: Axes, s: Series, change: Change | None) -> None:
    """Estimates as dots, weekly means with their bands, the day of a change."""
    dates, parts = s.start / _DAY, [s]
    if change is not None:
        day = datetime.fromisoformat(change.day).replace(tzinfo=UTC).timestamp()
        axis.axvline(day / _DAY, color=AFTER, lw=1.0, ls="--")
        parts = split_series(s, day)
    for band in map(make_band, parts):
        weeks = band.start / _DAY
        axis.fill_between(weeks, band.mean - band.half, band.mean + band.half, color=BAND, lw=0)
        axis.plot(weeks, band.mean, color=AFTER, lw=1.3, marker="o", ms=2.5)
    axis.plot(dates, s.value, ".", ms=3.0, color=BEFORE)
    low, high = axis.get_ylim()
    least = _LEAST_SHARE * abs(low + high) / 2.0
    if high - low < least:  # drives that differ by rounding alone
        axis.set_ylim((low + high - least) / 2.0, (low + high + least) / 2.0)
    axis.set_title(f"{clean(s.car, 14)}: {s.quantity}")
    ends = sorted({int(dates[0]), int((dates[0] + dates[-1]) / 2.0), int(dates[-1])})
    axis.set_xticks(ends, [f"{datetime.fromtimestamp(d * _DAY, UTC):%-d %b}" for d in ends])
