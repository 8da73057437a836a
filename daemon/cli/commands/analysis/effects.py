"""The effects that can be simulated and diagnosed, with their equations.

steerd effects
steerd effects steer_backlash
"""

import argparse

from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The effect and the output format."""
    option(parser, "name", "NAME", "one effect, or an alias of it", nargs="?")
    option(parser, "--json", "", "the same for programs")
    option(parser, "--page", "", "the same as a Markdown page")


def run(args: argparse.Namespace) -> int:
    """Print the table, or one effect."""
    from steerd.car_model.effects import EFFECTS, find_effect
    from steerd.daemon.analysis.effects_text import (
        format_effect,
        format_table,
        make_json,
        make_page,
    )

    try:
        effect = find_effect(args.name) if args.name else None
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint, ExitCode.USAGE) from error
    if args.json:
        import json

        print(json.dumps(make_json([effect] if effect else EFFECTS.values()), indent=1))
    elif args.page:
        print(make_page(), end="")
    else:
        print(format_effect(effect) if effect else format_table())
    return ExitCode.OK
