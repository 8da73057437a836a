"""The recorded drives of a machine: a table of figures, read from the files and remembered.

The figures are kept in an SQLite file in the user's cache folder, one row a session, by name, size
and date of change. It can be deleted at any time: the next listing reads the files again. What
people write about a session lies beside it, in `NAME.notes.toml`, and goes where the file goes.
"""

# Why: docs/decisions/messages-and-sessions.md#d68

import contextlib
import os
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import platformdirs
import tomlkit

from steerd.daemon.assembly.session_meta import sessions_folder
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, reading
from steerd.daemon.common.row_file import RowFile
from steerd.daemon.common.screen import clean, cut, wrap
from steerd.daemon.common.written import write_whole
from steerd.daemon.settings.run_options import RunOptions, recorded_options
from steerd.sysid.report.report import Card, Cell, Report, Section, Table
from steerd.toml_text import load_toml

_SCHEMA = 3  # of the remembered rows: others are read anew
_TAG_MAX, _NOTE_MAX = 40, 500


@dataclass(frozen=True)
class Entry:
    """One session; figures that it does not hold are None or empty."""

    path: Path  # the file
    changed_ns: int  # when it was last written [UNIX ns]: when the drive ended
    car: str = ""  # as in the session
    mode: str = ""  # the same
    lane: str = ""  # the path, as `--path` takes it, or the excitation plan
    seconds: float = 0.0  # length
    metres: float | None = None  # driven
    speed: float | None = None  # the highest [m/s]
    e1_rms: float | None = None  # lateral error after the approach [m]
    e1_max: float | None = None  # the largest [m]
    verdict: str = ""  # `ok`, or why it was stopped or cannot be used
    missing_s: float = 0.0  # how long the recorder did not get everything
    tags: tuple[str, ...] = ()  # what people wrote about it
    note: str = ""  # the same, a sentence

    @property
    def when(self) -> datetime:
        """When the drive ended, in local time."""
        return datetime.fromtimestamp(self.changed_ns / 1e9).astimezone()

    @property
    def remarks(self) -> str:
        """What is not ordinary about a drive, and what people wrote."""
        parts = [] if self.verdict == "ok" else [self.verdict]
        parts += [f"records dropped within {self.missing_s:.1f} s"] if self.missing_s else []
        return " · ".join(filter(None, [*parts, " ".join(f"#{t}" for t in self.tags), self.note]))


def default_folders() -> tuple[Path, ...]:
    """Where drives are looked for: this folder, and the one that recordings go to by themselves."""
    kept = sessions_folder()
    here = Path.cwd()
    return (here,) if kept.resolve() == here.resolve() else (here, kept)


def find_sessions(folders: Iterable[Path]) -> list[Path]:
    """Session files of folders, the one that was written last first."""
    found = [path for folder in folders if folder.is_dir() for path in folder.glob("*.mcap")]
    dated = []
    for path in found:
        with contextlib.suppress(OSError):  # gone since
            dated.append((path.stat().st_mtime_ns, path))
    return [path for _, path in sorted(dated, key=lambda row: (-row[0], str(row[1])))]


def find_session(text: str, folders: Iterable[Path] | None = None) -> Path:
    """The session that a word names: a file, `@last`, or `@-2` for the last but one.

    Raises:
        SteerdError: there are not so many, or the word after `@` means nothing.
    """
    if not text.startswith("@") or Path(text).exists():
        return Path(text)
    word = re.fullmatch("@(last|-0*([1-9][0-9]*))", text)
    if word is None:
        raise UsageError(f"{text}: no such session", "@last, or @-2 for the last but one")
    places, back = tuple(folders or default_folders()), int(word[2] or 1)
    found = find_sessions(places)
    if len(found) < back:
        shown = " or ".join(str(place) for place in places)
        what = f"{text}: {len(found) or 'no'} session{'' if len(found) == 1 else 's'} in {shown}"
        raise SteerdError(what, "record one with `steerd run`, or name a file", ExitCode.UNREADABLE)
    return found[back - 1]


# -- notes -----------------------------------------------------------------------------------------


def notes_file(session: Path) -> Path:
    """Where people's words about a session lie."""
    return session.with_suffix(".notes.toml")


def read_notes(session: Path) -> tuple[tuple[str, ...], str]:
    """Tags and note of a session; none where there is no such file, or it is none of ours."""
    try:
        table = load_toml(notes_file(session))
        tags = tuple(clean(str(tag), _TAG_MAX) for tag in table.get("tags", []))
        return tags, clean(str(table.get("note", "")), _NOTE_MAX)
    except (OSError, ValueError, TypeError):
        return (), ""


def write_notes(session: Path, tags: Iterable[str], note: str) -> None:
    """Write tags and note beside a session.

    Raises:
        SteerdError: there is no such session, or the file cannot be written.
    """
    if not session.is_file():
        raise SteerdError(f"{session} does not exist", "", ExitCode.UNREADABLE)
    said = {"tags": list(dict.fromkeys(tags)), "note": note}
    write_whole(notes_file(session), tomlkit.dumps(said))


# -- the index -------------------------------------------------------------------------------------


def list_entries(
    paths: Iterable[Path], advance: Callable[[float], None] = lambda done: None
) -> Iterator[Entry]:
    """The sessions' figures, remembered while a file is as it was; `advance` hears files done."""
    with contextlib.closing(_open_index()) as index:
        for number, path in enumerate(paths):
            with contextlib.suppress(OSError):
                entry = _remembered(index, path)
                tags, note = read_notes(path)
                yield replace(entry, tags=tags, note=note)
            advance(number + 1.0)


def index_file() -> Path:
    """The remembered figures; it may be deleted."""
    return platformdirs.user_cache_path("steerd") / "sessions.sqlite"


def _open_index() -> RowFile:
    """The index; one in memory where the file cannot be used."""
    with contextlib.suppress(OSError, sqlite3.Error):
        index_file().parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(sqlite3.DatabaseError):
            return RowFile(index_file())
        index_file().unlink()  # no database: made anew
        return RowFile(index_file())
    return RowFile(None)


def _remembered(index: RowFile, path: Path) -> Entry:
    """The figures of a file, from the index or, when it has changed, from itself."""
    about, name = path.stat(), str(path.resolve())
    basis = f"{about.st_size} {about.st_mtime_ns} {_SCHEMA}"
    with contextlib.suppress(sqlite3.Error, ValueError, TypeError):
        if (row := index.read(name, basis)) is not None:
            return Entry(path, about.st_mtime_ns, **row)
    entry = summarise(path)
    row = asdict(entry)
    kept = {k: v for k, v in row.items() if k not in ("path", "changed_ns", "tags", "note")}
    with contextlib.suppress(sqlite3.Error):  # a read-only or full disk: read again next time
        index.write(name, basis, kept)
    return entry


def summarise(path: Path) -> Entry:
    """Read a session's figures; what cannot be read is said in the verdict."""
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.motion import rms

    changed_ns = path.stat().st_mtime_ns
    try:
        read = load_recording(path)
        report = make_session_report(read)
        with reading(path):
            missing_s = 1e-9 * sum(last - first for first, last in read.session.holes())
            lane, followed = _lane(recorded_options(report.info.metadata))
    except SteerdError as error:
        return Entry(path, changed_ns, verdict=clean(f"unreadable: {error}", 60))
    errors = read.lane_errors.tolist() if followed else []
    end = report.end if report.info.finished else "the recorder was killed"
    return Entry(
        path,
        changed_ns,
        car=clean(report.car, 24),
        mode=clean(report.mode, 12),
        lane=lane,
        seconds=report.info.duration_s,
        metres=report.length_m,
        speed=report.speed.high if report.speed else None,
        e1_rms=rms(read.lane_errors) if errors else None,
        e1_max=max(errors) if errors else None,
        verdict=clean(report.stops[0], 60) if report.stops else "ok" if end else "no end",
        missing_s=missing_s,
    )


def _lane(options: RunOptions | None) -> tuple[str, bool]:
    """What was driven, a plan or a path with its speed, and whether a lane was followed."""
    if options is None:
        return "", True
    if options.drill:
        return clean(options.drill.partition(";")[0], 24), "closed" in options.drill
    return clean(f"{options.path} {options.speed:g} m/s", 40), True


_NAME, _CAR, _LANE = 20, 8, 17  # columns of the names [characters]


def format_entries(entries: Sequence[Entry], numbers: Sequence[int]) -> Iterator[str]:
    """The table, newest first; `numbers`: each one's place among all, 1 for the last (`@-N`)."""
    form = f"{{:<6}}{{:<12}}{{:<{_NAME + 1}}}{{:<{_CAR + 1}}}{{:<{_LANE + 1}}}{{:>5}}{{:>8}}"
    yield form.format("", "ended", "session", "car", "driven", "m", "e1 mm")
    for number, e in zip(numbers, entries, strict=True):
        place = "@last" if number == 1 else f"@-{number}"
        names = cut(clean(e.path.stem), _NAME), cut(e.car, _CAR), cut(e.lane, _LANE)
        metres = "" if e.metres is None else f"{e.metres:.0f}"
        error = "" if e.e1_rms is None else f"{1e3 * e.e1_rms:.1f}"
        yield form.format(place, f"{e.when:%m-%d %H:%M}", *names, metres, error)
        yield from wrap(e.remarks, " " * 6, " " * 6)


def make_json(entries: Iterable[Entry]) -> dict[str, Any]:
    """The drives as JSON values."""
    return {
        "schema": "steerd.sessions/1",
        "sessions": [{**asdict(e), "path": str(e.path)} for e in entries],
    }


# -- the page --------------------------------------------------------------------------------------

_HEADS = (
    "session", "how it ended", "when", "driven", "e1 RMS [mm]", "e1 largest [mm]",
    "fastest [m/s]", "time [s]", "length [m]", "car",
)  # fmt: skip


def make_report(entries: Sequence[Entry], folder: Path) -> Report:
    """What the page shows of drives, in this order; its links start at the folder where it lies."""
    minutes = sum(e.seconds for e in entries) / 60.0
    cards = [
        Card("drives", str(len(entries)), f"{sum(e.verdict != 'ok' for e in entries)} not ok"),
        Card("driven", f"{sum(e.metres or 0.0 for e in entries):.0f} m", f"in {minutes:.1f} min"),
    ]
    errors = [(e.e1_max, clean(e.path.stem)) for e in entries if e.e1_max is not None]
    if errors:
        largest, name = max(errors)
        cards.append(Card("largest e1", f"{1e3 * largest:.1f} mm", name))
    table = Table(_HEADS, [_row(e, folder) for e in entries], words=(0, 1, 3, 9))
    text = (
        "A name leads to the drive's page, where `steerd plot` has made one beside the session. e1 "
        "is the distance from the lane later than 3 s after the start."
    )
    return Report(
        title="Recorded drives",
        lead="" if entries else "There is none.",
        cards=cards,
        sections=[Section(text=text, table=table)] if entries else [],
        foot="Written by steerd sessions. Times are local, those of the end.",
    )


def _row(e: Entry, folder: Path) -> list[str | Cell]:
    page = e.path.with_suffix(".html")
    link = quote(os.path.relpath(page, folder)) if page.is_file() else ""
    errors = [None if error is None else 1e3 * error for error in (e.e1_rms, e.e1_max)]
    numbers = (*errors, e.speed, e.seconds, e.metres)
    figures = ["–" if number is None else f"{number:.1f}" for number in numbers]
    ended = Cell(e.remarks or "ok", "" if e.verdict == "ok" else "strong")
    named = Cell(clean(e.path.stem), link=link)
    return [named, ended, f"{e.when:%Y-%m-%d %H:%M}", e.lane, *figures, e.car]
