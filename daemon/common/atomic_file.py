"""Text files written whole or not at all."""

import contextlib
import os
import tempfile
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError


def write_whole(path: Path, text: str) -> None:
    """Write a file in one move, so that nobody ever sees half of it.

    Raises:
        SteerdError: its folder cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        what = f"{path}: {error.strerror}"
        raise SteerdError(what, "choose another folder", ExitCode.UNREADABLE) from None
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise SteerdError(f"{path}: {error.strerror}", "", ExitCode.UNREADABLE) from None
