"""Files written whole or not at all, with errors that a person can act on."""

from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.atomic_file import is_full, write_atomically

_ELSEWHERE = "choose another folder"


def write_whole(path: Path, text: str | bytes) -> None:
    """Write a file in one move, so that nobody ever sees half of it.

    Raises:
        SteerdError: it or its folder cannot be written.
    """
    try:
        write_atomically(path, text)
    except OSError as error:
        what = f"{path}: {error.strerror}"
        hint = "free some space, or choose another folder" if is_full(error) else _ELSEWHERE
        raise SteerdError(what, hint, ExitCode.UNREADABLE) from None
