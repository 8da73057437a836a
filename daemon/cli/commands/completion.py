"""`steerd completion`: the scripts of shells, and the manual page."""

import re
from argparse import ArgumentParser, Namespace
from pathlib import Path

import shtab

from steerd.daemon.cli.arguments import list_actions, option
from steerd.daemon.cli.main import ABOUT, COMMANDS, find_command
from steerd.version import VERSION

SHELLS = ("bash", "zsh", "tcsh", "fish")
_FILE_MARKS = ("FILE", "PATH", "SESSION", ".toml", ".mcap", ".html", "DEV")
"""A value whose metavar holds one of these is a file's name; `DIR` is a folder's."""


def completion_arguments(parser: ArgumentParser) -> None:
    option(parser, "shell", None, "a shell, or man for the manual", choices=(*SHELLS, "man"))


def completion(args: Namespace) -> None:
    """Print a completion script for your shell, or the manual page.

    steerd completion bash > ~/.local/share/bash-completion/completions/steerd
    steerd completion zsh > ~/.zfunc/_steerd        (a folder of $fpath)
    steerd completion tcsh >> ~/.tcshrc
    steerd completion fish > ~/.config/fish/completions/steerd.fish
    steerd completion man > ~/.local/share/man/man1/steerd.1
    """
    parser = make_full_parser()
    print(make_manual(parser) if args.shell == "man" else shtab.complete(parser, args.shell))


def make_manual(parser: ArgumentParser) -> str:
    """The manual page in roff; the same text for the same commands and version."""
    from argparse_manpage.manpage import Manpage

    parser.description = ABOUT
    page = str(Manpage(parser, _data={"version": VERSION, "project_name": "steerd"}))
    # The day on which it was printed is nobody's business.
    head = f'.TH STEERD "1" "" "steerd {VERSION}" "steerd"'
    return re.sub("(?m)^[.]TH .*$", head, page, count=1)


def make_full_parser() -> ArgumentParser:
    """One parser that knows every command's options; running a command needs only its own."""
    parser = ArgumentParser(prog="steerd")
    parser.add_argument("--version", action="store_true", help="print the version")
    children = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (_, text) in COMMANDS.items():
        child = children.add_parser(name, help=text)
        find_command(name).add_arguments(child)
        for action in list_actions(child):
            metavar = str(action.metavar or "")
            if action.nargs == 0 or action.choices is not None:
                continue
            if "DIR" in metavar:
                action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
            elif action.type is Path or any(mark in metavar for mark in _FILE_MARKS):
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    return parser
