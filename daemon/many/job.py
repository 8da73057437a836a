"""One engine for many drives: a row each, finished ones kept, then a table, a screen and a page.

Finished rows lie in a file beside the table until it is written, or, where a job grows with its
sessions, for good: the same command does what is new, and what had failed. The table is Parquet,
which pandas, polars, DuckDB, R and MATLAB read without a word about types or units. This is the
only file that knows PyArrow.
"""

import hashlib
import io
import json
import sqlite3
import sys
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, TypeVar

from steerd.daemon.analysis.options import Reported
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.notebook import make_frame, notebook_progress
from steerd.daemon.common.row_file import Row, RowFile
from steerd.daemon.common.screen import show_progress
from steerd.daemon.common.written import check_outputs, write_outputs
from steerd.daemon.many.units import Done, Where, Work, run_units

if TYPE_CHECKING:
    import pandas

FAILED = "failed"  # outcome of a row whose unit failed; the next start tries it again
Rows = Sequence[Mapping[str, Any]]
_TYPES = {"number": "float64", "count": "int64", "text": "string"}


class Column(NamedTuple):
    """A column of a table."""

    name: str  # of the column
    kind: Literal["number", "count", "text"]  # of its values; each may be missing
    unit: str = ""  # SI, `1` for none; empty where it is no number
    meaning: str = ""  # one line


class RowTable(tuple[Row, ...]):
    """Rows of a table; a cell of a notebook shows how many, and their columns."""

    def __repr__(self) -> str:
        return f"<{len(self)} rows of {', '.join(self[0]) if self else 'nothing'}>"


@dataclass(frozen=True, eq=False)
class Found(Reported):
    """What was found on many drives; `print` shows the screen."""

    rows: tuple[Row, ...] = field(repr=False)  # one drive each, values by column
    worked: int  # drives that this start worked on; the others had been finished before
    wall: float  # how long that took [s]

    @property
    @abstractmethod
    def columns(self) -> Sequence[Column]:
        """The columns of the table with units and meanings."""

    def to_pandas(self) -> "pandas.DataFrame":
        """The rows as a data frame; `attrs["units"]` holds the units by column."""
        values = {c.name: [row.get(c.name) for row in self.rows] for c in self.columns}
        return make_frame(values, {c.name: c.unit for c in self.columns})

    def encode_table(self) -> bytes:
        """The rows as a Parquet file, NaN as missing; the same rows give the same bytes."""
        import pyarrow as pa  # noqa: TID251
        from pyarrow import parquet  # noqa: TID251

        about = ((c, {"unit": c.unit, "meaning": c.meaning}) for c in self.columns)
        fields = [pa.field(c.name, _TYPES[c.kind], metadata=note) for c, note in about]
        known = [{name: v for name, v in row.items() if v == v} for row in self.rows]
        out = io.BytesIO()
        table = pa.Table.from_pylist(known, schema=pa.schema(fields))
        parquet.write_table(table, out, compression="zstd")
        return out.getvalue()

    def save_table(self, path: Path | str) -> Path:
        """Write that file, whole or not at all; its path.

        Raises:
            SteerdError: it cannot be written there.
        """
        check_outputs({"save_table": Path(path)})
        write_outputs({Path(path): self.encode_table()})
        return Path(path)


def make_digest(values: Any) -> str:
    """SHA-256 of JSON values: of what rows depend on."""
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


F = TypeVar("F", bound=Found)


class Job(NamedTuple, Generic[F]):
    """What is to be done with many drives."""

    label: str  # of the progress
    work: Work  # what is done with one unit's argument, in a worker
    units: Mapping[str, Any]  # arguments by the unit's name
    basis: str  # digest of all that the rows depend on
    # The table's row of a unit that has ended; its `outcome` is `FAILED` or another
    make_row: Callable[[Done], Row]
    # The result, of rows, how many of them are new, and the seconds that took
    make: Callable[[tuple[Row, ...], int, float], F]
    # Makes an argument complete before it leaves for another machine
    ship: Callable[[Any], Any] = lambda about: about
    # The same command will be given again, with more units: what is finished is kept
    grows: bool = False


def do_job(
    job: Job[F],
    where: Where,
    output: Path | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> F:
    """Do what an earlier start did not finish; what is finished lies beside `output`, the table.

    Raises:
        SteerdError: what lies there belongs to other work, or the cluster is lost.
    """
    if output is not None:
        check_outputs({"-o": output})
    began = time.perf_counter()
    with open_finished(output and finished_path(output), job.basis) as (rows, keep):
        done = {unit for unit, row in rows.items() if row["outcome"] != FAILED}
        todo = {unit: about for unit, about in job.units.items() if unit not in done}
        before = len(job.units) - len(todo)
        progress(before)
        for number, end in enumerate(run_units(job.work, todo, where, job.ship), 1):
            rows[end.unit] = job.make_row(end)
            keep(end.unit, job.basis, rows[end.unit])
            progress(before + number)
    found = RowTable(rows[unit] for unit in job.units)
    return job.make(found, len(todo), time.perf_counter() - began)


def do_in_notebook(job: Job[F], where: Where, output: Path | str | None) -> F:
    """Do the job below a cell's bar, and write its table."""
    path = None if output is None else Path(output)
    with notebook_progress(job.label, len(job.units)) as progress:
        found = do_job(job, where, path, progress)
    write_found(job, found, path)
    return found


def do_in_terminal(job: Job[F], where: Where, output: Path | None, page: Path | None) -> None:
    """Do the job under a bar, print what was found, write table and page."""
    with show_progress(job.label, float(len(job.units)), even=True) as progress:
        found = do_job(job, where, output, progress)
    print(found, flush=True)
    write_found(job, found, output, page)


def write_found(job: Job[F], found: F, output: Path | None, page: Path | None = None) -> None:
    """Write table and page; finished rows of a job that does not grow are then no longer needed.

    Raises:
        SteerdError: one cannot be written; the finished rows stay.
    """
    table = found.encode_table() if output else None
    text = found.render_report() if page else None
    write_outputs({output: table, page: text}, announced=True)
    if output and not job.grows:
        finished_path(output).unlink(missing_ok=True)


def finished_path(output: Path) -> Path:
    """Where the finished units of a table lie."""
    return output.with_name(f"{output.name}.journal")


@contextmanager
def open_finished(
    path: Path | None, basis: str
) -> Iterator[tuple[dict[str, Row], Callable[[str, str, Row], None]]]:
    """The rows that an earlier start finished by unit, and what keeps one more.

    Raises:
        SteerdError: they belong to other work, are in use, or cannot be written.
    """
    try:
        with closing(RowFile(path, alone=True)) as file:
            old = file.read_all()
            if any(of != basis for of, _ in old.values()):
                what = f"{path} holds what another command had finished"
                hint = f"name another -o, or delete {path and path.name}: it is then done again"
                raise UsageError(what, hint)
            yield {unit: row for unit, (_, row) in old.items()}, file.write
    except KeyboardInterrupt:
        if path is not None:
            text = "interrupted; the same command goes on where it was"
            print(f"{text} ({path})", file=sys.stderr)
        raise
    except sqlite3.Error as error:
        raise _make_error(path, error) from None


def _make_error(path: Path | None, error: sqlite3.Error) -> SteerdError:
    match error.sqlite_errorname:
        case "SQLITE_NOTADB":
            what = f"{path} holds no finished rows of steerd"
            return UsageError(what, "name another -o, or delete it")
        case "SQLITE_BUSY":
            what, hint = f"{path}: another command is writing it", "wait for it, or name another -o"
        case _:
            what, hint = f"{path}: {error}", "free some space, or choose another folder"
    return SteerdError(what, hint, ExitCode.UNREADABLE)
