"""Completion scripts and the manual page, of the commands' own parsers."""

import argparse
import importlib
import re
from collections.abc import Mapping
from pathlib import Path

import shtab

SHELLS = ("bash", "zsh", "tcsh", "fish")
_FILE_MARKS = ("FILE", "PATH", "SESSION", ".toml", ".mcap", ".html", "DEV")
"""A value whose metavar holds one of these is a file's name; `DIR` is a folder's."""


def make_script(shell: str, commands: Mapping[str, tuple[str, str]]) -> str:
    """The completion script for a shell of `SHELLS`.

    Args:
        shell: the shell's name.
        commands: module below `steerd.daemon.cli.commands` and one line of help, by command.
    """
    return str(shtab.complete(make_full_parser(commands), shell))


def make_manual(commands: Mapping[str, tuple[str, str]], version: str) -> str:
    """The manual page in roff; the same text for the same commands and version.

    Args:
        commands: as for `make_script`.
        version: of steerd.
    """
    from argparse_manpage.manpage import Manpage

    parser = make_full_parser(commands)
    parser.description = "Control, identification and sim-to-real diagnosis for Ackermann cars."
    page = str(Manpage(parser, _data={"version": version, "project_name": "steerd"}))
    # The day on which it was printed is nobody's business.
    return _HEAD.sub(f'.TH STEERD "1" "" "steerd {version}" "steerd"', page, count=1)


_HEAD = re.compile(r"^\.TH .*$", re.MULTILINE)


def make_full_parser(commands: Mapping[str, tuple[str, str]]) -> argparse.ArgumentParser:
    """One parser that knows every command's options; running a command needs only its own."""
    parser = argparse.ArgumentParser(prog="steerd")
    parser.add_argument("--version", action="store_true", help="print the version")
    children = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (module, text) in commands.items():
        child = children.add_parser(name, help=text)
        importlib.import_module(f"steerd.daemon.cli.commands.{module}").add_arguments(child)
        _mark_files(child)
    return parser


def _mark_files(parser: argparse.ArgumentParser) -> None:
    """Say which values are file names, by the attribute that shtab looks for."""
    for action in parser._actions:  # noqa: SLF001 (argparse has no public list)
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for child in action.choices.values():
                _mark_files(child)
        elif action.nargs != 0 and action.choices is None:
            metavar = str(action.metavar or "")
            if "DIR" in metavar:
                action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
            elif action.type is Path or any(mark in metavar for mark in _FILE_MARKS):
                action.complete = shtab.FILE  # type: ignore[attr-defined]
