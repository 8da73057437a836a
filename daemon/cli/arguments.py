"""Arguments of commands: how one is declared, and what several commands take.

Files that a command reads are looked for before the command loads anything heavy: by the `type` of
the argument that names them. What is wrong inside a file is for the command to say, once it has
loaded what reads it.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.screen import below_home
from steerd.daemon.settings.run_options import RunOptions

_CAR_HINT = "check the path; `steerd config` prints a complete car file"
_SESSION = "a session file (.mcap), @last or @-2 (default: @last)"


def option(
    to: argparse._ActionsContainer, name: str, value: str | None, text: str, **more: Any
) -> None:
    """Declare an argument.

    `name` is `--free`, `-o --output`, or that of a positional argument; `value` what the help calls
    its value, empty for a switch, None for the name itself; `text` is one line of help.
    """
    if value == "":
        more.setdefault("action", "store_true")
    else:
        more["metavar"] = value
    if more.get("action") == "append":
        more["default"] = []
    to.add_argument(*name.split(), help=text, **more)


# -- what several commands take --------------------------------------------------------------------


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """The daemon's endpoint, and our certificates."""
    option(parser, "--connect", "ENDPOINT", f"the daemon's (default {RunOptions.listen})")
    option(parser, "--lab", "DIR", "our folder of `steerd keys`", type=Path)


def add_car_arguments(parser: argparse.ArgumentParser) -> None:
    """Which car, and where."""
    add_bus_arguments(parser)
    option(parser, "--name", None, "the car's name", default="car1")


def add_session(parser: argparse.ArgumentParser) -> None:
    """One session, or the last one."""
    option(parser, "session", "SESSION", _SESSION, type=expect_session, nargs="?", default="@last")


def add_sessions(parser: argparse.ArgumentParser) -> None:
    """Any number of sessions; none means the last one."""
    option(parser, "sessions", "SESSION.mcap", _SESSION, type=expect_session, nargs="*")


def pick_session(text: str) -> Path:
    """The file; one that was not named is shown on standard error.

    Raises:
        SteerdError: there is none.
    """
    from steerd.daemon.sessions.catalogue import find_session

    path = find_session(text)
    if str(path) != text:
        print(f"session: {below_home(path)}", file=sys.stderr)
    return path


def pick_sessions(texts: list[str]) -> list[Path]:
    """The files, see `pick_session`."""
    return [pick_session(text) for text in texts or ["@last"]]


def split_list(text: str) -> list[str]:
    """The words of a value."""
    return [part for part in text.split(",") if part]


def split_sessions(text: str) -> list[Path]:
    """Session files, each expected to be there."""
    return [Path(expect_session(part)) for part in split_list(text)]


def split_held_out(text: str) -> list[int | Path]:
    """What `--held-out` names: numbers, or files; both is for the command to refuse."""
    if any(part.lstrip("-").isdigit() for part in split_list(text)):
        return [int(p) if p.lstrip("-").isdigit() else Path(p) for p in split_list(text)]
    return [*split_sessions(text)]


def list_actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Arguments of a parser and of its subcommands."""
    for action in parser._actions:  # noqa: SLF001 (argparse has no public list)
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for child in action.choices.values():
                yield from list_actions(child)
        else:
            yield action


# -- files that must be there: types of arguments, which raise a SteerdError -----------------------


def is_missing(text: str) -> bool:
    """Whether there is no such file; of one that cannot be looked at its reader says why."""
    try:
        Path(text).stat()
        return False
    except OSError as error:
        return isinstance(error, FileNotFoundError | NotADirectoryError)


def expect_file(text: str, hint: str = "") -> Path:
    """A file."""
    if is_missing(text):
        raise SteerdError(f"{text} does not exist", hint, ExitCode.UNREADABLE)
    return Path(text)


def expect_session(text: str) -> str:
    """A session, or a drive such as `@last`; a killed recorder left its beginning."""
    if not text.startswith("@"):
        expect_file(text, "" if is_missing(f"{text}.partial") else f"steerd recover {text}")
    return text


def expect_partial(text: str) -> Path:
    """A session whose recorder may have been killed."""
    return expect_file(text) if is_missing(f"{text}.partial") else Path(text)


def expect_car(text: str) -> str:
    """A car file, or `hidden:SEED`."""
    if not text.startswith("hidden:"):
        expect_file(text, _CAR_HINT)
    return text


def expect_lane(text: str) -> str:
    """A path as `--path` takes it, of which `csv:FILE` names a file."""
    kind, _, rest = text.strip().partition(":")
    file = rest.split(",")[0]
    if kind == "csv" and is_missing(file):
        what = f"--path {text}: path file {file}: No such file or directory"
        raise SteerdError(what, "", ExitCode.USAGE)
    return text
