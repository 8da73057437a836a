"""The sessions of a batch, what is asked of each, and its row of the table."""

import glob
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from steerd.car_model.car_file import CarFile
from steerd.car_model.params import wheelbase
from steerd.daemon.assembly.session_meta import is_virtual
from steerd.daemon.common.errors import ExitCode, SteerdError, load_car_file
from steerd.daemon.common.screen import clean
from steerd.daemon.many.job import make_digest
from steerd.daemon.sessions.info import load_session

_EARLIEST_NS = 946_684_800_000_000_000
"""The year 2000 [UNIX ns]: a log whose clock began at zero has no date of its own."""
_CAR_MAX = 24  # characters of a car's name that are kept
Kind = Literal["summarise", "identify", "diagnose"]


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
    """Sessions that folders (with all below), patterns and files name, each once.

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
    """The row of one session; a SteerdError where it cannot be used for what is asked."""
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
    match question.kind:
        case "summarise":
            return row | _summarise(path)
        case "identify":
            return row | _identify(path, car)
        case "diagnose":
            return row | _diagnose(path, car)


def day_of(start: float) -> str:
    """The day of a time [UNIX s], in UTC."""
    return f"{datetime.fromtimestamp(start, UTC):%Y-%m-%d}"


def _summarise(path: Path) -> dict[str, Any]:
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
