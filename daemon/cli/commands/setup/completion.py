"""Print a completion script for your shell.

steerd completion bash > ~/.local/share/bash-completion/completions/steerd
steerd completion zsh >> ~/.zshrc
"""

import argparse

from steerd.daemon.common.errors import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The shell."""
    parser.add_argument("shell", choices=("bash", "zsh"))


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from steerd.daemon.cli.completion import make_script, read_commands
    from steerd.daemon.cli.main import COMMANDS

    modules = {name: module for name, (module, _) in COMMANDS.items()}
    print(make_script(args.shell, list(read_commands(modules))), end="")
    return ExitCode.OK
