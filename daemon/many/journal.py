"""Finished work units, one line of JSON each: an interrupted command goes on where it was.

The first line says what the units belong to. A line that was torn when a process was killed is cut
off, so its unit is done again. Numbers keep every digit, so a table made of a journal does not
depend on how often the work was interrupted.
"""

import fcntl
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from steerd.daemon.common.errors import ExitCode, SteerdError

SCHEMA = "steerd.journal/1"
Row = dict[str, Any]
"""Values by column, each a number, a text, a truth value or None."""


@dataclass
class Journal:
    """Finished units of one command.

    Attributes:
        path: the file.
        rows: by the unit's name.
    """

    path: Path
    rows: dict[str, Row] = field(default_factory=dict)
    _file: BinaryIO | None = None

    def add(self, unit: str, row: Row) -> None:
        """Write a finished unit.

        Raises:
            SteerdError: the disk takes no more.
        """
        self.rows[unit] = row
        if self._file is None:
            return
        try:
            self._file.write(_line({"unit": unit, "row": row}))
            self._file.flush()
        except OSError as error:
            raise SteerdError(
                f"{self.path}: {error.strerror}",
                "free some space; the same command goes on where it was",
                ExitCode.UNREADABLE,
            ) from None


def journal_path(output: Path) -> Path:
    """Where the finished units of a result lie until it is written."""
    return output.with_name(f"{output.name}.journal")


@contextmanager
def open_journal(path: Path | None, purpose: str) -> Iterator[Journal]:
    """The journal of a command, with what an interrupted one left.

    Args:
        path: the file; None keeps the rows in memory alone.
        purpose: digest of all that the rows depend on.

    Raises:
        SteerdError: it belongs to other work, is in use, or cannot be written.
    """
    if path is None:
        yield Journal(Path())
        return
    try:
        file = path.open("a+b")
    except OSError as error:
        what, hint = f"{path}: {error.strerror}", "choose another folder"
        raise SteerdError(what, hint, ExitCode.UNREADABLE) from None
    with file:
        _lock(file, path)
        yield Journal(path, _take_over(file, path, purpose), file)


@contextmanager
def going_on(output: Path | None) -> Iterator[None]:
    """Say at Ctrl-C that the same command goes on, where it does."""
    try:
        yield
    except KeyboardInterrupt:
        if output is not None:
            text = "interrupted; the same command goes on where it was"
            print(f"{text} ({journal_path(output)})", file=sys.stderr)
        raise


def _lock(file: BinaryIO, path: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        what, hint = f"{path}: another command is writing it", "wait for it, or name another -o"
        raise SteerdError(what, hint, ExitCode.UNREADABLE) from None


def _take_over(file: BinaryIO, path: Path, purpose: str) -> dict[str, Row]:
    """The rows of an earlier start; the file ends behind the last whole one."""
    file.seek(0)
    lines, whole = file.read().split(b"\n")[:-1], 0
    rows: dict[str, Row] = {}
    for number, line in enumerate(lines):
        try:
            said = json.loads(line)
            if number:
                rows[said["unit"]] = said["row"]
            elif said["schema"] != SCHEMA:
                raise ValueError
            elif said["of"] != purpose:
                what = f"{path} holds what another command had finished"
                hint = f"name another -o, or delete {path.name}: its units are then done again"
                raise SteerdError(what, hint, ExitCode.USAGE)
        except (ValueError, KeyError, TypeError):
            if number:
                break
            what = f"{path} is no journal of steerd"
            raise SteerdError(what, "name another -o", ExitCode.USAGE) from None
        whole += len(line) + 1
    file.truncate(whole)
    if not whole:
        file.write(_line({"schema": SCHEMA, "of": purpose}))
        file.flush()
    return rows


def _line(said: dict[str, Any]) -> bytes:
    return json.dumps(said, separators=(",", ":")).encode() + b"\n"
