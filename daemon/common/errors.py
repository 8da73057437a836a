"""Failures: one sentence for what happened, one for what to try, and an exit code."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum


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

    Args:
        about: begins the sentence.
        hint: what to try.
        code: of a ValueError; what the system refuses is unreadable.
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
