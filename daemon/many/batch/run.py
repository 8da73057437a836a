"""`steerd.batch`: hundreds of sessions, each a row; what changed on which car, and when."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import get_args

from steerd.daemon.common.errors import UsageError
from steerd.daemon.common.notebook import speaking_of_arguments
from steerd.daemon.common.row_file import Row
from steerd.daemon.common.screen import clean, shown, wrap
from steerd.daemon.many.batch import changes as steps
from steerd.daemon.many.batch import unit
from steerd.daemon.many.batch.changes import Change, Series
from steerd.daemon.many.job import FAILED, Column, Found, Job, do_in_notebook
from steerd.daemon.many.units import Done, Where
from steerd.sysid.report.report import Report, format_table

DONE = "done"
_FAILURES, _CHANGES = 5, 12  # lines of each that are shown
_HEAD = (
    Column("session", "text", "", "file"),
    Column("car", "text", "", "name"),
    Column("day", "text", "", "of the drive, UTC"),
    Column("start", "number", "s", "UNIX time of the drive"),
    Column("outcome", "text", "", "done or failed"),
    Column("failure", "text", "", "why it failed"),
    Column("tries", "count", "", "times that it was begun"),
)
_TEXTS = ("lane", "mode", "verdict", "causes")
_NO_ESTIMATE = ("start", "tries", "seconds", "metres")


@shown
@dataclass(frozen=True, eq=False)
class Batch(Found):
    """What a batch found; `print(batch)` is the screen of `steerd batch`."""

    kind: unit.Kind  # what was asked

    @property
    def columns(self) -> Sequence[Column]:
        """The columns of the table."""
        more = {name for row in self.rows for name in row} - {column.name for column in _HEAD}
        rest = (Column(n, "text" if n in _TEXTS else "number") for n in sorted(more))
        return (*_HEAD, *rest)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Columns that hold estimates."""
        names = (column.name for column in self.columns if column.kind == "number")
        return tuple(n for n in names if n not in _NO_ESTIMATE and not n.endswith("_sd"))

    @cached_property
    def series(self) -> tuple[Series, ...]:
        """Every quantity of every car with enough drives, over time."""
        return tuple(steps.list_series(self.rows, self.quantities))

    @cached_property
    def changes(self) -> tuple[Change, ...]:
        """What changed, the clearest first."""
        return tuple(steps.find_changes(self.series))

    def make_report(self) -> Report:
        """What the page shows: quantities over weeks with their bands, and the days of changes."""
        from steerd.daemon.many.batch.page import make_report

        return make_report(self.kind, self.rows, self.series, self.changes)

    def __str__(self) -> str:
        rows, failed = self.rows, [row for row in self.rows if row["outcome"] == FAILED]
        cars = Counter(str(row["car"]) for row in rows if row.get("car") is not None)
        days = sorted({row["day"] for row in rows if row.get("day")})
        between = f", {' to '.join(sorted({days[0], days[-1]}))}" if days else ""
        count = f"{len(rows)} of {len(cars)} car{'' if len(cars) == 1 else 's'}{between}"
        lines = wrap(f"{count}; {self.worked} worked on now", "sessions   ", " " * 11)
        verdicts = Counter(clean(str(r["verdict"]), 40) for r in rows if r.get("verdict"))
        reported = ", ".join(f"{count} {text}" for text, count in verdicts.most_common(6))
        lines += wrap(reported, "verdicts   ", " " * 11)
        if failed:
            lines.append(f"failed     {len(failed)}")
        for row in failed[:_FAILURES]:
            session = str(row["session"])
            name = session.rpartition("/")[2]
            text = clean(str(row["failure"]).replace(session, name))
            text = text if name in text else f"{clean(name, 40)}: {text}"
            lines += wrap(text, " " * 11, " " * 13)
        lines.append("")
        if not self.changes:
            lines.append(steps.nothing_changed(len(self.series)))
        else:
            table = steps.tabulate_changes(self.changes[:_CHANGES])
            heads = ("car", "quantity", "since", "before", "after", "sigma")
            lines += format_table(table.pick(*heads))
        if len(self.changes) > _CHANGES:
            lines.append(f"and {len(self.changes) - _CHANGES} more: see the table or --page")
        return "\n".join(lines)


@speaking_of_arguments
def batch(
    kind: unit.Kind,
    sessions: str | Path | Sequence[str | Path],
    *,
    cars: Path | str | None = None,
    output: Path | str | None = None,
    jobs: int = 0,
    dask: str | None = None,
) -> Batch:
    """Summarise, identify or diagnose many sessions, each by itself.

    Args:
        kind: `summarise`, `identify` or `diagnose`.
        sessions: folders (with all below), patterns and files.
        cars: a folder with NAME.toml for the car NAME, or one car file for all: where an
            identification starts, what a diagnosis takes for the car.
        output: Parquet file to write; what is finished is not done again.
        jobs: worker processes; 0 for one per core.
        dask: address of a Dask scheduler instead.

    Returns:
        The table, and what changed on which car and when.

    Raises:
        SteerdError: an argument cannot be used. A session that fails is a row.
    """
    if kind not in get_args(unit.Kind):
        raise UsageError(f"kind {kind!r}: {' or '.join(get_args(unit.Kind))}")
    words = [sessions] if isinstance(sessions, str | Path) else list(sessions)
    paths = unit.find_batch([str(word) for word in words])
    job = make_job(paths, unit.Question(kind, unit.read_cars(None if cars is None else Path(cars))))
    return do_in_notebook(job, Where(jobs, dask), output)


def make_job(paths: Sequence[Path], question: unit.Question) -> Job[Batch]:
    """What is asked of sessions as work for `do_job`."""
    tasks = unit.make_tasks(paths)

    def make_row(done: Done) -> Row:
        row = {"session": str(tasks[done.unit].path), "tries": done.tries}
        row |= {"outcome": FAILED if done.row is None else DONE, "failure": done.failure}
        start = (done.row or {}).get("start")
        return row | (done.row or {}) | ({} if start is None else {"day": unit.day_of(start)})

    work, make = partial(unit.run_unit, question), partial(Batch, kind=question.kind)
    basis, ship = question.digest(), unit.read_content
    return Job(question.kind, work, tasks, basis, make_row, make, ship, grows=True)
