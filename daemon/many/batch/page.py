"""The page of `steerd batch`: quantities over weeks, car by car, and the days of changes."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from matplotlib.axes import Axes

from steerd.daemon.common.screen import clean
from steerd.daemon.many.batch import changes as steps
from steerd.daemon.many.batch.changes import Change, Series
from steerd.daemon.many.job import FAILED, Rows
from steerd.sysid.report.drawing import AFTER, BAND, BEFORE, Diagrams
from steerd.sysid.report.report import Card, Report, Section, Table

_DAY = 86_400.0
_FIGURES = 30
"""Series that are drawn: those that changed first; more make a page nobody looks through."""
_SESSIONS, _FAILURES = 200, 20  # rows of a table; the others are in the file of `-o`
_WORDS = ("car", "day", "verdict", "causes", "lane")
_FOUND = (
    ("seconds", "driven [s]", 1.0), ("metres", "driven [m]", 1.0), ("e1_rms", "e1 RMS [mm]", 1e3),
    ("e1_max", "e1 largest [mm]", 1e3), ("prediction", "off after 1 s [mm]", 1e3),
)  # fmt: skip
"""Columns of the table of sessions: texts, then figures with their heads and scales."""
_ESTIMATES = 5
_LEAST_SHARE = 0.01  # least height of a diagram, as a share of what it shows


def make_report(
    kind: str, rows: Rows, series: Sequence[Series], changes: Sequence[Change]
) -> Report:
    """What the page shows."""
    first = {(c.car, c.quantity): c for c in changes}
    ordered = sorted(series, key=lambda s: (s.car, s.quantity) not in first)
    sections = [
        Section("Cars", table=_count_cars(rows)),
        Section("Sessions", _more(len(rows), _SESSIONS), table=_list_sessions(rows)),
    ]
    if changes:
        sections.insert(0, Section(
            "What changed, and since when",
            "A step in the estimates of one car that chance explains in less than one batch of a "
            "thousand. Between: days between which the first one lies (95 %).",
            table=steps.tabulate_changes(changes),
        ))  # fmt: skip
    if ordered:
        drawn = ordered[:_FIGURES]

        def plot(*axes: Axes) -> None:
            for axis, s in zip(axes, drawn, strict=True):
                _plot_series(axis, s, first.get((s.car, s.quantity)))

        sections.append(Section(
            "Over time",
            "Dots are single drives, the line is the mean of each week with its 95 % band; a "
            f"dashed line marks a change. {len(drawn)} of {len(ordered)} series are drawn, those "
            "that changed first.",
            figures=[Diagrams(plot, 2.0, count=len(drawn), columns=3)],
        ))  # fmt: skip
    if failed := [row for row in rows if row["outcome"] == FAILED]:
        shown = [(clean(str(row["session"]), 60), clean(row["failure"])) for row in failed]
        table = Table(("session", "why"), shown[:_FAILURES], words=(1,))
        sections.append(Section("What failed", _more(len(failed), _FAILURES), table=table))
    return Report(
        title=f"{len(rows)} sessions, batch {kind}",
        sections=sections,
        foot="Written by steerd batch. Dates are UTC; units are SI where none is named.",
        cards=list(_cards(rows, series, changes)),
    )


def _cards(rows: Rows, series: Sequence[Series], changes: Sequence[Change]) -> Iterator[Card]:
    """The figures that are read first; of each car that changed the clearest change."""
    cars = len({row["car"] for row in rows if row.get("car")})
    failed = sum(row["outcome"] == FAILED for row in rows)
    yield Card("sessions", str(len(rows)), f"{cars} car{'s' * (cars != 1)}; {failed} failed")
    for c in {change.car: change for change in reversed(changes)}.values():
        text = f"{c.before:.4g} → {c.after:.4g}"
        yield Card(f"{clean(c.car, 24)} since {c.day}", clean(c.quantity, 24), text)
    if not changes:
        yield Card("changes", "none", steps.nothing_changed(len(series)))


def _count_cars(rows: Rows) -> Table:
    cars: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        cars.setdefault(str(row.get("car") or "?"), []).append(row)
    table = []
    for car, own in sorted(cars.items()):
        days = sorted(row["day"] for row in own if row.get("day")) or ["–"]
        failed = sum(row["outcome"] == FAILED for row in own)
        table.append((clean(car, 24), str(len(own)), str(failed), days[0], days[-1]))
    return Table(("car", "sessions", "failed", "first", "last"), table)


def _more(count: int, most: int) -> str:
    return f"{count - most} more are in the table of `-o`." if count > most else ""


def _list_sessions(rows: Rows) -> Table:
    """Each session and what was found, the newest first; estimates as many as a page is wide."""
    newest = sorted(rows, key=lambda row: -(row.get("start") or 0.0))[:_SESSIONS]
    estimated = Counter(n for row in newest for n in row if f"{n}_sd" in row)
    figures = [f for f in _FOUND if any(f[0] in row for row in newest)]
    figures += [(name, name, 1.0) for name, _ in estimated.most_common(_ESTIMATES)]
    texts = [name for name in _WORDS if any(row.get(name) for row in newest)]
    table = []
    for row in newest:
        values = ((row.get(name), scale) for name, _, scale in figures)
        scaled = ("–" if value is None else f"{scale * value:.4g}" for value, scale in values)
        name = clean(str(row["session"]).rpartition("/")[2])
        table.append((name, *(clean(str(row.get(text) or "–"), 24) for text in texts), *scaled))
    heads = ("session", *texts, *(head for _, head, _ in figures))
    return Table(heads, table, words=[0, *(i for i, t in enumerate(texts, 1) if t != "day")])


def _plot_series(axis: Axes, s: Series, change: Change | None) -> None:
    """Estimates as dots, weekly means with their bands, the day of a change."""
    dates, parts = s.start / _DAY, [s]
    if change is not None:
        axis.axvline(change.begin / _DAY, color=AFTER, lw=1.0, ls="--")
        parts = steps.split_series(s, change.begin)
    for band in map(steps.make_band, parts):
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
