"""Output files of a command, checked before the work; a recorded drive is never overwritten."""

import os
from collections.abc import Mapping
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.mcap_records import MAGIC


def check_outputs(outputs: Mapping[str, Path | None]) -> None:
    """Refuse output files that cannot be written or that are sessions.

    Args:
        outputs: path by option name; None where the option was not given.

    Raises:
        SteerdError: an output is a session or a folder, its folder is missing or read-only, or
            two options name one file.
    """
    taken: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        _check(option, path)
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            what = f"{other} and {option} name the same file, {path}"
            raise SteerdError(what, "give each its own name", ExitCode.USAGE)


def _check(option: str, path: Path) -> None:
    if _is_session(path):
        what = f"{option} {path}: that is a session, and a session is never overwritten"
        raise SteerdError(what, "choose another name", ExitCode.USAGE)
    if path.is_dir():
        what = f"{option} {path}: that is a folder"
        raise SteerdError(what, "name a file in it", ExitCode.UNREADABLE)
    if not path.parent.is_dir():
        what = f"{option} {path}: there is no folder {path.parent}"
        raise SteerdError(what, "choose another folder", ExitCode.UNREADABLE)
    if not os.access(path.parent, os.W_OK | os.X_OK):
        what = f"{option} {path}: the folder {path.parent} cannot be written"
        raise SteerdError(what, "choose another folder", ExitCode.UNREADABLE)


def _is_session(path: Path) -> bool:
    """Whether it begins as sessions do; an unreadable file is reported by its reader."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False
