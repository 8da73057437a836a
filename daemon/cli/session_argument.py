"""The session that a command looks at: a file, `@last`, `@-2`, or the last one if none is named."""

import argparse
import sys
from pathlib import Path

from steerd.daemon.cli.inputs import reads_session

HELP = "a session file (.mcap), @last or @-2 (default: @last)"


def add_session(parser: argparse.ArgumentParser) -> None:
    """One session, or the last one."""
    reads_session(
        parser.add_argument("session", nargs="?", default="@last", metavar="SESSION", help=HELP)
    )


def add_sessions(parser: argparse.ArgumentParser) -> None:
    """Any number of sessions; none means the last one."""
    reads_session(parser.add_argument("sessions", nargs="*", metavar="SESSION.mcap", help=HELP))


def pick_session(text: str) -> Path:
    """The file; one that was not named is shown on standard error.

    Raises:
        SteerdError: there is none.
    """
    from steerd.daemon.common.screen import below_home
    from steerd.daemon.sessions.catalogue import find_session

    path = find_session(text)
    if str(path) != text:
        print(f"session: {below_home(path)}", file=sys.stderr)
    return path


def pick_sessions(texts: list[str]) -> list[Path]:
    """The files, see `pick_session`.

    Raises:
        SteerdError: there is none.
    """
    return [pick_session(text) for text in texts or ["@last"]]


def split_list(text: str) -> list[str]:
    """The words of a value."""
    return [part for part in text.split(",") if part]


def split_paths(text: str) -> list[Path]:
    """Files."""
    return [Path(part) for part in split_list(text)]


def split_held_out(text: str) -> list[int | Path]:
    """What `--held-out` names: numbers, and files."""
    return [int(p) if p.lstrip("-").isdigit() else Path(p) for p in split_list(text)]
