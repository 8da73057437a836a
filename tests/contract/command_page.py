"""The page of commands from the parsers themselves: `python -m tests.contract.command_page`."""

import argparse
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from steerd.daemon.cli.main import COMMANDS, find_command
from steerd.daemon.common.packaged import EXAMPLES

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "commands.md"
COMMON = 3  # commands with the same line from which it is a common one
_HEAD = """# Commands

Every command with its arguments and options, from the parsers themselves.
`python -m tests.contract.command_page` writes this page and a test compares it.
`steerd COMMAND --help` prints the same; where options are many it shows those that most
drives need, and `--help-all` the rest. Exit codes are in
[troubleshooting](../how-to/troubleshooting.md#exit-codes).
"""


def make_parser(name: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"steerd {name}", add_help=False)
    find_command(name).add_arguments(parser)
    return parser


def _text(text: str) -> str:
    """In one line; the examples' folder, which each machine has elsewhere, by its name."""
    return " ".join(text.replace(f"{EXAMPLES}/", "examples/").split()).replace("%%", "%")


def _name(action: argparse.Action) -> str:
    """An argument as it is typed, with the name of its value."""
    value = action.metavar or action.dest.upper()
    if action.choices is not None and action.metavar is None:
        value = "|".join(str(choice) for choice in action.choices)
    if not action.option_strings:
        return str(value)
    names = ", ".join(action.option_strings)
    return names if action.nargs == 0 else f"{names} {value}"


def _rows(prog: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    """A list for a parser, then one for each of its subcommands."""
    shown = [a for a in parser._actions if a.help != argparse.SUPPRESS]
    groups = [a for a in shown if isinstance(a, argparse._SubParsersAction)]
    plain = [a for a in shown if a not in groups and "--help" not in a.option_strings]
    if plain:
        yield ""
    for action in plain:
        meaning = f": {_text(action.help)}" if action.help else ""
        yield f"- `{_text(_name(action))}`{meaning}"
    for group in groups:
        for name, sub in group.choices.items():
            yield from ("", f"### steerd {prog} {name}")
            yield from _rows(f"{prog} {name}", sub)


def make_page() -> str:
    """The whole page; what many commands say alike stands once, before them."""
    found = {name: list(_rows(name, make_parser(name))) for name in COMMANDS}
    counts = Counter(row for rows in found.values() for row in set(rows) if row.startswith("- "))
    # The commonest text of an option; another one stays with its command.
    often = [row for row, n in reversed(counts.most_common()) if n >= COMMON]
    texts = {row.split("`")[1].split()[0]: row for row in often}
    common = {row: name for name, row in texts.items()}
    lines = [_HEAD, "## Common options", "", *sorted(common)]
    for name, (_, summary) in COMMANDS.items():
        also = ", ".join(f"`{common[row]}`" for row in found[name] if row in common)
        lines += ["", f"## steerd {name}", "", f"{summary[0].upper()}{summary[1:]}."]
        lines += [f"Common: {also}."] if also else []
        lines += [row for row in found[name] if row not in common]
    text = re.sub("\n{3,}", "\n\n", "\n".join(lines))
    return text.rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(make_page(), encoding="utf-8")
