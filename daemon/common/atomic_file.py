"""Text files written whole or not at all, with errors that a person can act on."""

from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.atomic_file import write_atomically


def write_whole(path: Path, text: str) -> None:
    """Write a file in one move, so that nobody ever sees half of it.

    Raises:
        SteerdError: it or its folder cannot be written.
    """
    try:
        write_atomically(path, text)
    except OSError as error:
        what = f"{path}: {error.strerror}"
        raise SteerdError(what, "choose another folder", ExitCode.UNREADABLE) from None
