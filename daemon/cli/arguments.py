"""Arguments of commands: how one is declared, and what several commands take.

Files that a command reads are looked for before the command loads anything heavy: by the `check` of
their argument, which `main` runs. What is wrong inside a file the command says that reads it.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.screen import below_home
from steerd.daemon.settings.run_options import HIDDEN, RunOptions

Check = Callable[[str], SteerdError | None]
"""The error of a file that is not there, None of one that is and of what names no file."""
_CAR_HINT = "check the path; `steerd config` prints a complete car file"
_SESSION = "a session file (.mcap), @last or @-2 (default: @last)"


def option(
    to: argparse._ActionsContainer,
    name: str,
    value: str | None,
    text: str,
    check: Check | None = None,
    **more: Any,
) -> None:
    """Declare an argument: `--free`, `-o --output`, or a positional one's name; `text` is its help.

    `value` is what the help calls its value, empty for a switch, None for the name itself; `check`
    looks for the files that the value names.
    """
    if value == "":
        more.setdefault("action", "store_true")
    else:
        more["metavar"] = value
    if more.get("action") == "append":
        more["default"] = []
    action = to.add_argument(*name.split(), help=text, **more)
    action.find_missing = check  # type: ignore[attr-defined]


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
    option(parser, "session", "SESSION", _SESSION, missing_session, nargs="?", default="@last")


def add_sessions(parser: argparse.ArgumentParser) -> None:
    """Any number of sessions; none means the last one."""
    usual = ["@last"]
    option(parser, "sessions", "SESSION.mcap", _SESSION, missing_session, nargs="*", default=usual)


def pick_session(text: str) -> Path:
    """The file, see `find_session`; one that was not named is shown on standard error."""
    from steerd.daemon.sessions.catalogue import find_session

    path = find_session(text)
    if str(path) != text:
        print(f"session: {below_home(path)}", file=sys.stderr)
    return path


def split_list(text: str) -> list[str]:
    """The words of a value."""
    return [part for part in text.split(",") if part]


def split_held_out(text: str) -> list[int | Path]:
    """What `--held-out` names: numbers, and files."""
    return [int(p) if p.lstrip("-").isdigit() else Path(p) for p in split_list(text)]


# -- files that are not there ----------------------------------------------------------------------


def check_inputs(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Refuse the first file that is not there, a car file first: one holds for all sessions."""
    found = ((getattr(a, "find_missing", None), a.dest) for a in list_actions(parser))
    checks = [(check, dest) for check, dest in found if check is not None]
    for check, dest in sorted(checks, key=lambda each: each[0] is not missing_car):
        for error in map(check, _texts(getattr(args, dest, None))):
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


def missing_file(text: str, hint: str = "") -> SteerdError | None:
    """The error of a file that is not there."""
    try:
        Path(text).stat()
    except (FileNotFoundError, NotADirectoryError):
        return SteerdError(f"{text} does not exist", hint, ExitCode.UNREADABLE)
    except OSError:
        return None  # its reader says why it cannot be read
    return None


def missing_session(text: str) -> SteerdError | None:
    """The same of a session, or a drive such as `@last`; a killed recorder left its beginning."""
    if text.startswith("@"):
        return None
    cut = missing_file(f"{text}.partial") is None
    return missing_file(text, f"steerd recover {text}" if cut else "")


def missing_partial(text: str) -> SteerdError | None:
    """The same of a session whose recorder may have been killed."""
    return missing_file(f"{text}.partial") and missing_file(text)


def missing_car(text: str) -> SteerdError | None:
    """The same of a car file, or `hidden:SEED`."""
    return None if text.startswith(HIDDEN) else missing_file(text, _CAR_HINT)


def missing_lane(text: str) -> SteerdError | None:
    """The same of a path as `--path` takes it, of which `csv:FILE` names a file."""
    kind, _, rest = text.strip().partition(":")
    file = rest.split(",")[0]
    if kind != "csv" or missing_file(file) is None:
        return None
    what = f"--path {text}: path file {file}: No such file or directory"
    return SteerdError(what, "", ExitCode.USAGE)


def _texts(value: Any) -> Iterable[str]:
    """The file names of an argument's values; `-` is none, nor is what stands beside a number."""
    values = value if isinstance(value, list) else [value]
    numbered = any(isinstance(each, int) for each in values)  # every K-th part
    return () if numbered else (str(each) for each in values if each and str(each) != "-")
