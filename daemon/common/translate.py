"""Errors of other rooms as the command line reports them: what, what to try, which exit code."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from pathlib import Path

    from steerd.car_model.car_file import CarFile, CarFileError
    from steerd.steer_bus.session_read import SessionError


def make_car_file_error(error: "CarFileError") -> SteerdError:
    """For a car file that cannot be read or written (exit code 3) or is not valid (4)."""
    unreadable = isinstance(error.__cause__, OSError)
    code = ExitCode.UNREADABLE if unreadable else ExitCode.INVALID
    place = f"{error.path}: {error.where}" if error.where else str(error.path)
    return SteerdError(f"{place}: {error.what}", error.hint, code)


def load_car_file(path: "Path | str | None") -> "CarFile":
    """A car file that somebody named, F1TENTH's for None, with what identify knows of the car.

    Raises SteerdError: it cannot be read, or says something impossible.
    """
    from steerd.car_model.car_file import CarFileError, default_car_path, load_car

    try:
        return load_car(path or default_car_path())
    except CarFileError as error:
        raise make_car_file_error(error) from None


def make_session_error(error: "SessionError", hint: str = "") -> SteerdError:
    """For a session that cannot be read or written.

    Args:
        error: as it was raised.
        hint: what to try where the error has no hint of its own.
    """
    what = str(error).removesuffix(f" ({error.hint})") if error.hint else str(error)
    return SteerdError(what, error.hint or hint, ExitCode(error.exit_code))


@contextmanager
def reading(name: object, hint: str = "") -> Iterator[None]:
    """The one guard around what reads a file from elsewhere: its content raises one line.

    Args:
        name: of the file, for people.
        hint: what to try where the error has no hint of its own.

    Raises:
        SteerdError: it holds what cannot be read.
    """
    from steerd.steer_bus.session_read import SessionError

    try:
        yield
    except SessionError as error:
        raise make_session_error(error, hint) from error
    except (ValueError, LookupError, RecursionError, MemoryError, csv.Error) as error:
        known = {RecursionError: "nested too deeply", MemoryError: "more than memory holds"}
        text = known.get(type(error), str(error)[:200] or type(error).__name__)
        text = f"it lacks {error.args[0]}" if isinstance(error, KeyError) else text
        raise SteerdError(f"{name}: {text}", hint) from error
