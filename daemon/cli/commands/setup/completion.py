"""Print a completion script for your shell.

steerd completion bash > ~/.local/share/bash-completion/completions/steerd
steerd completion zsh > ~/.zfunc/_steerd        (a folder of $fpath)
steerd completion tcsh >> ~/.tcshrc
steerd completion fish > ~/.config/fish/completions/steerd.fish
"""

import argparse

from steerd.daemon.cli.completion import SHELLS, make_script
from steerd.daemon.common.errors import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The shell."""
    parser.add_argument("shell", choices=SHELLS)


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from steerd.daemon.cli.main import COMMANDS

    print(make_script(args.shell, COMMANDS))
    return ExitCode.OK
