"""`steerd.batch`: hundreds of sessions, each a row; what changed on which car, and when."""

import glob
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args

from steerd.car_model.car_file import CarFile
from steerd.car_model.params import wheelbase
from steerd.daemon.assembly.session_meta import is_virtual
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, load_car_file
from steerd.daemon.common.notebook import speaking_of_arguments
from steerd.daemon.common.row_file import Row
from steerd.daemon.common.screen import clean, shown, wrap
from steerd.daemon.many.batch import changes as steps
from steerd.daemon.many.batch.changes import Change, Series, day_of
from steerd.daemon.many.job import FAILED, Column, Found, Job, do_in_notebook, make_digest
from steerd.daemon.many.units import Done, Where
from steerd.daemon.sessions.info import load_session
from steerd.sysid.report.report import Report, format_table

_EARLIEST_NS = 946_684_800_000_000_000
"""The year 2000 [UNIX ns]: a log whose clock began at zero has no date of its own."""
_CAR_MAX = 24  # characters of a car's name that are kept
Kind = Literal["summarise", "identify", "diagnose"]
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


@dataclass(frozen=True)
class Question:
    """What is asked of every session."""

    kind: Kind
    # Car file by the car's name, under "" that of every other car; where there is none,
    # identification starts at the F1TENTH car and a diagnosis takes the session's
    cars: Mapping[str, CarFile]

    def digest(self) -> str:
        """What a session's row depends on, beside the session itself."""
        texts = {name: [car.text, car.posterior] for name, car in sorted(self.cars.items())}
        return make_digest([self.kind, texts])


@dataclass(frozen=True)
class UnitTask:
    """One session, as a worker is handed it."""

    path: Path  # the file
    changed_ns: int  # when it was last written [UNIX ns]
    # Of the file, for workers that do not see it; None for those that do
    content: bytes | None = None


def read_content(task: UnitTask) -> UnitTask:
    """The task with its file's content; as it is where the file is gone: its worker says so."""
    try:
        return replace(task, content=task.path.read_bytes())
    except OSError:
        return task


def find_batch(words: Sequence[str]) -> list[Path]:
    """Sessions that folders (with all below them), patterns and files name; each once.

    Raises:
        SteerdError: a word names nothing.
    """
    found: dict[Path, None] = {}
    for word in words:
        path = Path(word)
        if path.is_dir():
            paths = sorted(path.rglob("*.mcap"))
        elif path.exists():
            paths = [path]
        else:
            names = map(Path, sorted(glob.glob(word, recursive=True)))  # noqa: PTH207
            paths = [name for name in names if name.is_file() and name.suffix == ".mcap"]
        if not paths:
            what = f"{word}: no session" if path.exists() else f"{word} does not exist"
            raise SteerdError(what, "name folders, patterns or files", ExitCode.UNREADABLE)
        found |= dict.fromkeys(paths)
    return sorted(found)


def read_cars(named: Path | None) -> dict[str, CarFile]:
    """Car files by the cars' names: of a folder `NAME.toml` each, or one file for every car.

    Raises:
        SteerdError: there is none, or one cannot be used.
    """
    if named is None:
        return {}
    if not named.is_dir():
        return {"": load_car_file(named)}
    files = sorted(named.glob("*.toml"))
    if not files:
        what = f"{named} holds no car file"
        raise SteerdError(what, "NAME.toml for the car NAME", ExitCode.UNREADABLE)
    return {file.stem: load_car_file(file) for file in files}


def make_tasks(paths: Sequence[Path]) -> dict[str, UnitTask]:
    """Tasks by name: a file that was written since is another unit."""
    tasks = {}
    for path in paths:
        about = path.stat()
        unit = f"{path} {about.st_size} {about.st_mtime_ns}"
        tasks[unit] = UnitTask(path, about.st_mtime_ns)
    return tasks


# -- in a worker ---------------------------------------------------------------------------------


def run_unit(question: Question, task: UnitTask) -> dict[str, Any]:
    """The row of one session.

    Raises:
        SteerdError: the session cannot be used for what is asked.
    """
    if task.content is None:
        return _answer(task.path, question, task.changed_ns)
    with tempfile.TemporaryDirectory(prefix="steerd-") as folder:
        path = Path(folder) / task.path.name
        path.write_bytes(task.content)
        try:
            return _answer(path, question, task.changed_ns)
        except SteerdError as error:  # its reader knows the copy alone
            what = error.what.replace(str(path), str(task.path))
            raise SteerdError(what, error.hint, error.code) from None


def _answer(path: Path, question: Question, changed_ns: int) -> dict[str, Any]:
    info = load_session(path).info()
    # Drives in virtual time all begin on one date, and logs whose clock began at zero have none.
    dated = info.start_ns >= _EARLIEST_NS and not is_virtual(info)
    name = clean(info.metadata.get("steerd.session", {}).get("car", ""), _CAR_MAX)
    row = {"car": name, "start": (info.start_ns if dated else changed_ns) * 1e-9}
    car = question.cars.get(name, question.cars.get(""))
    ask = {"summarise": _summarise, "identify": _identify, "diagnose": _diagnose}[question.kind]
    return row | ask(path, car)


def _summarise(path: Path, _: CarFile | None) -> dict[str, Any]:
    from steerd.daemon.sessions.catalogue import summarise

    entry = summarise(path)
    if entry.verdict.startswith("unreadable"):
        raise SteerdError(entry.verdict)
    names = ("lane", "mode", "verdict", "seconds", "metres", "e1_rms", "e1_max")
    return {name: getattr(entry, name) for name in names}


def _identify(path: Path, start: CarFile | None) -> dict[str, Any]:
    from steerd.daemon.analysis.identification import identify

    start = start or load_car_file(None)
    # A ruler's length: one drive does not decide a car's scale.
    found = identify(path, car=start, wheelbase=wheelbase(start.car))
    said = found.to_json()
    horizons = said["held_out"]["horizons"]
    row: dict[str, Any] = {
        "verdict": "improved" if found.improved else "no better than the start",
        "prediction": next((h["position"] for h in horizons if h["horizon"] == 1.0), None),
    }
    for name, value in said["parameters"].items():
        if value["sd"] is not None:
            row |= {name: value["value"], f"{name}_sd": value["sd"]}
    return row


def _diagnose(path: Path, base: CarFile | None) -> dict[str, Any]:
    from steerd.daemon.analysis.diagnosis import diagnose

    said = diagnose(path, base=base, closed_loop=False).to_json()
    row: dict[str, Any] = {
        "verdict": said["verdict"],
        "causes": ", ".join(sorted(cause["effect"] for cause in said["causes"])),
        "gap": said["gap"]["before"]["whitened"],
        "gap_after": said["gap"]["after"]["whitened"],
    }
    for cause in said["causes"]:
        for name, value in cause["parameters"].items():
            if value["sd"] is not None and isfinite(value["value"]):
                column = f"{cause['effect']}.{name}"
                row |= {column: value["value"], f"{column}_sd": value["sd"]}
    return row


# -- many of them ---------------------------------------------------------------------------------


@shown
@dataclass(frozen=True, eq=False)
class Batch(Found):
    """What a batch found; `print(batch)` is the screen of `steerd batch`."""

    kind: Kind  # what was asked

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
    kind: Kind,
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
    if kind not in get_args(Kind):
        raise UsageError(f"kind {kind!r}: {' or '.join(get_args(Kind))}")
    words = [sessions] if isinstance(sessions, str | Path) else list(sessions)
    paths = find_batch([str(word) for word in words])
    job = make_job(paths, Question(kind, read_cars(None if cars is None else Path(cars))))
    return do_in_notebook(job, Where(jobs, dask), output)


def make_job(paths: Sequence[Path], question: Question) -> Job[Batch]:
    """What is asked of sessions as work for `do_job`."""
    tasks = make_tasks(paths)

    def make_row(done: Done) -> Row:
        row = {"session": str(tasks[done.unit].path), "tries": done.tries}
        row |= {"outcome": FAILED if done.row is None else DONE, "failure": done.failure}
        start = (done.row or {}).get("start")
        return row | (done.row or {}) | ({} if start is None else {"day": day_of(start)})

    work, make = partial(run_unit, question), partial(Batch, kind=question.kind)
    basis, ship = question.digest(), read_content
    return Job(question.kind, work, tasks, basis, make_row, make, ship, grows=True)
