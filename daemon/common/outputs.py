"""Where a command may write: told before the work, and a recorded drive is never written over."""

import os
from collections.abc import Mapping
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.mcap_records import MAGIC


def check_outputs(outputs: Mapping[str, Path | None]) -> None:
    """Refuse what cannot be written, or would cost a session.

    Args:
        outputs: files to write by the option that names each; None where it was not given.

    Raises:
        SteerdError: one is a session, a folder or in none that can be written, or two are one.
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
        what = f"{option} {path}: that is a session, and no session is ever written over"
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
    """Whether it begins as sessions do; what cannot be read is told by who reads it."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False
