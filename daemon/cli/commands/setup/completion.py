"""Print a completion script for your shell, or the manual page.

steerd completion bash > ~/.local/share/bash-completion/completions/steerd
steerd completion zsh > ~/.zfunc/_steerd        (a folder of $fpath)
steerd completion tcsh >> ~/.tcshrc
steerd completion fish > ~/.config/fish/completions/steerd.fish
steerd completion man > ~/.local/share/man/man1/steerd.1
"""

import argparse

from steerd.daemon.cli.completion import SHELLS, make_manual, make_script
from steerd.daemon.common.errors import ExitCode

MANUAL = "man"
"""Word for the manual page."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to print."""
    parser.add_argument("shell", choices=(*SHELLS, MANUAL), help="a shell, or man for the manual")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from steerd.daemon.cli.main import COMMANDS
    from steerd.version import VERSION

    if args.shell == MANUAL:
        print(make_manual(COMMANDS, VERSION))
    else:
        print(make_script(args.shell, COMMANDS))
    return ExitCode.OK
