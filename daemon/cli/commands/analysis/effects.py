"""The effects that can be simulated and diagnosed, with their equations.

steerd effects
steerd effects steer_backlash
steerd effects --add my_effect.py       # build one of your own into the library

An effect that was added is simulated, identified and named like any other, in
every command, car file and notebook of this installation. Building takes a
minute and a C compiler (`pip install ziglang`).
"""

import argparse
from pathlib import Path

from steerd.daemon.cli.arguments import missing_file, option


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "name", "NAME", "one effect, or an alias of it", nargs="?")
    option(parser, "--json", "", "the same for programs")
    option(parser, "--page", "", "the same as a Markdown page")
    own = parser.add_argument_group("effects of your own").add_mutually_exclusive_group()
    option(own, "--add", "FILE.py", "add those of a file", missing_file, type=Path)
    option(own, "--remove", "NAME.py", "take them away again", type=Path)


def run(args: argparse.Namespace) -> None:
    if args.add or args.remove:
        _change(args)
        return
    from steerd.car_model.effects import EFFECTS
    from steerd.daemon.analysis import effects_text
    from steerd.daemon.analysis.options import read_effects

    named = [EFFECTS[name] for name in read_effects([args.name] if args.name else [])]
    if args.json:
        import json

        print(json.dumps(effects_text.make_json(named or EFFECTS.values()), indent=1))
    elif args.page:
        print(effects_text.make_page(), end="")
    else:
        print(effects_text.format_effect(named[0]) if named else effects_text.format_table())


def _change(args: argparse.Namespace) -> None:
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.setup.own_effect import add_effect, remove_effect

    with show_progress("compiling the equations", 1.0):
        names = add_effect(args.add) if args.add else remove_effect(args.remove)
    print(f"added: {', '.join(names)}; try: steerd effects {names[0]}" if names else "removed")
