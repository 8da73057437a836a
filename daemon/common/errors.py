"""Failures: one sentence for what happened, one for what to try, and an exit code.

What other rooms raise is said as the command line reports it.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from steerd.car_model.car_file import CarFile, CarFileError
    from steerd.steer_bus.session_read import SessionError


class ExitCode(IntEnum):
    """Exit codes of the `steerd` command; documented in docs/how-to/troubleshooting.md."""

    OK = 0
    USAGE = 2  # the command line makes no sense
    UNREADABLE = 3  # a device or file cannot be opened or read
    INVALID = 4  # a car file, map or session was read but its content is wrong
    STOPPED = 5  # a safety stop ended the run, or a result is not reliable enough to be used
    UNREACHABLE = 6  # no running daemon answered
    DIFFERS = 7  # a replay gave other commands than were recorded
    INTERNAL = 70  # a bug in steerd
    INTERRUPTED = 130  # Ctrl-C before there was anything to stop


class SteerdError(Exception):
    """A failure that a person can act on."""

    def __init__(self, what: str, hint: str = "", code: ExitCode = ExitCode.INVALID) -> None:
        super().__init__(what)
        self.what = what  # what happened, one sentence
        self.hint = hint  # what to try, one sentence; may be empty
        self.code = code

    def __str__(self) -> str:
        return f"{self.what} — try: {self.hint}" if self.hint else self.what


class UsageError(SteerdError):
    """A command line, or an argument, that makes no sense."""

    def __init__(self, what: str, hint: str = "") -> None:
        super().__init__(what, hint, ExitCode.USAGE)


@contextmanager
def refusing(about: str = "", hint: str = "", code: ExitCode = ExitCode.USAGE) -> Iterator[None]:
    """What another room says of a value in the block is an error of the command line.

    `about` begins the sentence; `code` is a ValueError's; what the system refuses is unreadable.
    """
    try:
        yield
    except ValueError as error:
        raise SteerdError(f"{about}{error}", hint, code) from None
    except OSError as error:
        raise SteerdError(f"{about}{error.strerror}", hint, ExitCode.UNREADABLE) from None


def find_near(word: str, known: Iterable[str]) -> str:
    """The known word that is most like another one; empty if none is."""
    import difflib  # which most commands do without

    near = difflib.get_close_matches(word.lower(), list(known), n=1)
    return near[0] if near else ""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`did you mean X?`, or nothing."""
    near = find_near(word, known)
    return f"did you mean {near}?" if near else ""


# -- errors of other rooms -------------------------------------------------------------------------


def make_car_file_error(error: "CarFileError") -> SteerdError:
    """For a car file that cannot be read or written (exit code 3) or is not valid (4)."""
    unreadable = isinstance(error.__cause__, OSError)
    code = ExitCode.UNREADABLE if unreadable else ExitCode.INVALID
    place = f"{error.path}: {error.where}" if error.where else str(error.path)
    return SteerdError(f"{place}: {error.what}", error.hint, code)


def load_car_file(path: "Path | str | None") -> "CarFile":
    """A car file that somebody named, F1TENTH's for None, with what identify knows of the car.

    A SteerdError where it cannot be read, or says something impossible.
    """
    from steerd.car_model.car_file import CarFileError, default_car_path, load_car

    try:
        return load_car(path or default_car_path())
    except CarFileError as error:
        raise make_car_file_error(error) from None


def make_session_error(error: "SessionError", hint: str = "") -> SteerdError:
    """For a session that cannot be read or written; `hint` where the error has none of its own."""
    what = str(error).removesuffix(f" ({error.hint})") if error.hint else str(error)
    return SteerdError(what, error.hint or hint, ExitCode(error.exit_code))


@contextmanager
def reading(name: object, hint: str = "") -> Iterator[None]:
    """The one guard around what reads a file from elsewhere: its bad content is a SteerdError.

    `hint` is what to try where the error has none of its own.
    """
    from steerd.steer_bus.session_read import SessionError

    try:
        yield
    except SessionError as error:
        raise make_session_error(error, hint) from error
    except (ValueError, LookupError, RecursionError, MemoryError) as error:
        known = {RecursionError: "nested too deeply", MemoryError: "more than memory holds"}
        text = known.get(type(error), str(error)[:200] or type(error).__name__)
        text = f"it lacks {error.args[0]}" if isinstance(error, KeyError) else text
        raise SteerdError(f"{name}: {text}", hint) from error
