"""The sessions of a batch: folders, patterns and files; and what is asked of them."""

import glob
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from steerd.car_model.car_file import CarFile
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.translate import load_car_file

Kind = Literal["summarise", "identify", "diagnose"]
_PATTERN = frozenset("*?[")


@dataclass(frozen=True)
class Question:
    """What is asked of every session.

    Attributes:
        kind: summarise, identify or diagnose.
        cars: car file by the car's name, under "" that of every other car; where there is none,
            identification starts at the F1TENTH car and a diagnosis takes the session's.
    """

    kind: Kind
    cars: Mapping[str, CarFile]

    def digest(self) -> str:
        """What a session's row depends on, beside the session itself."""
        texts = {name: [car.text, car.posterior] for name, car in sorted(self.cars.items())}
        text = json.dumps([self.kind, texts])
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class UnitTask:
    """One session, as a worker is handed it.

    Attributes:
        path: the file.
        changed_ns: when it was last written [UNIX ns].
        question: what is asked.
        content: of the file, for workers that do not see it; None for those that do.
    """

    path: Path
    changed_ns: int
    question: Question
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
        paths = _expand(word)
        if not paths:
            what = f"{word}: no session" if Path(word).exists() else f"{word} does not exist"
            raise SteerdError(what, "name folders, patterns or files", ExitCode.UNREADABLE)
        found |= dict.fromkeys(paths)
    return sorted(found)


def _expand(word: str) -> list[Path]:
    path = Path(word)
    if path.is_dir():
        return sorted(path.rglob("*.mcap"))
    if path.exists() or not _PATTERN & set(word):
        return [path] if path.exists() else []
    names = (Path(name) for name in sorted(glob.glob(word, recursive=True)))  # noqa: PTH207
    return [name for name in names if name.is_file() and name.suffix == ".mcap"]


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


def make_tasks(paths: Sequence[Path], question: Question) -> dict[str, UnitTask]:
    """Tasks by name: a file that was written since is another unit."""
    tasks = {}
    for path in paths:
        about = path.stat()
        unit = f"{path} {about.st_size} {about.st_mtime_ns}"
        tasks[unit] = UnitTask(path, about.st_mtime_ns, question)
    return tasks
