"""The screen of `steerd batch`."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from steerd.daemon.common.screen import clean, wrap
from steerd.daemon.many.batch.changes import LEAST, Change
from steerd.sysid.report.report import Table, format_table

Rows = Sequence[Mapping[str, Any]]
_FAILURES, _CHANGES = 5, 12
"""Lines of each that are shown."""


def describe_batch(rows: Rows, worked: int, series: int, changes: Sequence[Change]) -> str:
    """The screen: how many (of them `worked` now), what failed, what changed in the series."""
    failed = [row for row in rows if row["outcome"] != "done"]
    cars = Counter(str(row["car"]) for row in rows if row.get("car") is not None)
    days = sorted({row["day"] for row in rows if row.get("day")})
    between = f", {days[0]} to {days[-1]}" if days else ""
    lines = wrap(
        f"sessions   {len(rows)} of {len(cars)} car{'' if len(cars) == 1 else 's'}{between}; "
        f"{worked} worked on now",
        "", " " * 11,
    )  # fmt: skip
    lines += wrap(_verdicts(rows), "verdicts   ", " " * 11)
    if failed:
        lines.append(f"failed     {len(failed)}")
    for row in failed[:_FAILURES]:
        lines += wrap(_failure(str(row["session"]), str(row["failure"])), " " * 11, " " * 13)
    return "\n".join([*lines, "", *_changes(changes, series)])


def _failure(session: str, why: str) -> str:
    """Why a session failed, with its name and without its folder."""
    name = session.rpartition("/")[2]
    text = clean(why.replace(session, name))
    return text if name in text else f"{clean(name, 40)}: {text}"


def _verdicts(rows: Rows) -> str:
    counts = Counter(clean(str(r["verdict"]), 40) for r in rows if r.get("verdict"))
    return ", ".join(f"{count} {text}" for text, count in counts.most_common(6))


def _changes(changes: Sequence[Change], series: int) -> Iterator[str]:
    if not changes:
        yield nothing_changed(series)
        return
    table = tabulate_changes(changes[:_CHANGES])
    yield from format_table(table.pick("car", "quantity", "since", "before", "after", "sigma"))
    if len(changes) > _CHANGES:
        yield f"and {len(changes) - _CHANGES} more: see the table or --page"


def nothing_changed(series: int) -> str:
    """Why no change is named: none was found, or none could be."""
    if not series:
        return f"no car has the {LEAST} drives from which a change could be seen"
    return f"no change beyond what chance explains, in {series} series"


def tabulate_changes(changes: Sequence[Change]) -> Table:
    """A row for each change."""
    heads = ("car", "quantity", "since", "between", "before", "after", "± (difference)", "sigma")
    rows = [
        (
            clean(c.car, 13), clean(c.quantity, 24), c.day, f"{c.earliest} to {c.latest}",
            f"{c.before:.4g}", f"{c.after:.4g}", f"{c.sd:.2g}", f"{c.sigmas:.0f}",
        )
        for c in changes
    ]  # fmt: skip
    return Table(heads, rows, words=(1,))
