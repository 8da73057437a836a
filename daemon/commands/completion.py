"""Print a completion script for your shell.

steerd completion bash > ~/.local/share/bash-completion/completions/steerd
steerd completion zsh >> ~/.zshrc
"""

import argparse

from daemon.errors import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The shell."""
    parser.add_argument("shell", choices=("bash", "zsh"))


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from daemon.cli import COMMANDS
    from daemon.completion import make_script, read_commands

    modules = {name: module for name, (module, _) in COMMANDS.items()}
    print(make_script(args.shell, list(read_commands(modules))), end="")
    return ExitCode.OK
