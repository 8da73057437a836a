"""Files that a command reads: looked for before the command loads anything heavy.

An argument that names such files is made with one of the functions below; `main` then looks whether
they are there as soon as the command line is parsed. What is wrong inside a file is for the command
to say, once it has loaded what reads it.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import ExitCode, SteerdError

Check = Callable[[str], SteerdError | None]
"""The error of a file that is not there, None of one that is and of what names no file."""
_CAR_HINT = "check the path; `steerd config` prints a complete car file"


def reads_session(action: argparse.Action) -> None:
    """The argument names sessions, or drives such as `@last`; commas may stand between them."""
    _mark(action, find_missing_session)


def reads_partial(action: argparse.Action) -> None:
    """The argument names a session, or one whose recorder was killed by its name to be."""
    _mark(action, lambda t: find_missing(Path(f"{t}.partial")) and find_missing(Path(t)))


def reads_car(action: argparse.Action) -> None:
    """The argument names a car file, or `hidden:SEED`."""
    _mark(action, _find_missing_car)


def reads_file(action: argparse.Action) -> None:
    """The argument names another file."""
    _mark(action, lambda text: find_missing(Path(text)))


def reads_lane(action: argparse.Action) -> None:
    """The argument is a path as `--path` takes it, of which `csv:FILE` names a file."""
    _mark(action, _find_missing_lane)


def is_input(action: argparse.Action) -> bool:
    """Whether the argument names files that the command reads."""
    return hasattr(action, "find_missing")


def check_inputs(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Refuse files that are not there, a car file first: one holds for all sessions.

    Raises:
        SteerdError: the first of them.
    """
    actions = list_actions(parser)
    for action in sorted(actions, key=lambda a: getattr(a, "find_missing", 0) != _find_missing_car):
        check: Check | None = getattr(action, "find_missing", None)
        for text in _texts(getattr(args, action.dest, None)) if check else ():
            error = check(text) if check else None
            if error is not None:
                raise error


def list_actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Arguments of a parser and of its subcommands."""
    for action in parser._actions:  # noqa: SLF001 (argparse has no public list)
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for child in action.choices.values():
                yield from list_actions(child)
        else:
            yield action


def find_missing(path: Path, hint: str = "") -> SteerdError | None:
    """The error of a file that is not there."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return SteerdError(f"{path} does not exist", hint, ExitCode.UNREADABLE)
    except OSError:
        return None  # its reader says why it cannot be read
    return None


def find_missing_session(text: str) -> SteerdError | None:
    """The error of a session that is not there; its killed recorder may have left the beginning."""
    path = Path(text)
    if text.startswith("@"):
        return None
    partial = path.with_name(f"{path.name}.partial") if path.name else path
    return find_missing(path, f"steerd recover {path}" if partial.exists() else "")


def _find_missing_car(text: str) -> SteerdError | None:
    return None if text.startswith("hidden:") else find_missing(Path(text), _CAR_HINT)


def _find_missing_lane(text: str) -> SteerdError | None:
    kind, _, rest = text.strip().partition(":")
    if kind != "csv" or find_missing(Path(rest.split(",")[0])) is None:
        return None
    what = f"--path {text}: path file {rest.split(',')[0]}: No such file or directory"
    return SteerdError(what, "", ExitCode.USAGE)


def _mark(action: argparse.Action, check: Check) -> None:
    action.find_missing = check  # type: ignore[attr-defined]


def _texts(value: Any) -> Iterable[str]:
    """The file names of an argument's values; `-` is none, nor is anything beside a number.

    A number is every K-th part, which no file may stand beside: that is for the command to refuse.
    """
    values = value if isinstance(value, list) else [value]
    parts = [
        part
        for each in values
        for part in ([str(each)] if isinstance(each, Path) else str(each or "").split(","))
    ]
    numbered = any(part.removeprefix("-").isdigit() for part in parts)
    return () if numbered else (part for part in parts if part and part != "-")
