"""A running car in a terminal: state, errors, rates and faults. Ctrl-C leaves.

steerd watch
steerd watch --lab screen
steerd watch --operate      # arm, start and stop here too; it holds the car

Keys change live parameters: the highest speed, a lane beside the path, a share
of the feedback. The car refuses those of anybody but the operator who holds it.
"""

import argparse
import contextlib

from steerd.daemon.cli.arguments import add_bus_arguments, option


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bus_arguments(parser)
    option(parser, "--name", None, "the car's name (default: the only one on the bus)")
    option(parser, "--operate", "", "keys arm, start and stop: closing this stops it")
    option(parser, "--seconds", "S", "leave after this time", type=float)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.ipc.operator import connect, read_lab

    if args.lab is not None:
        read_lab(args.lab)  # a folder that is none is refused before anything heavy is loaded
    from steerd.daemon.terminal.watch import watch_car

    with connect(args.connect, args.lab) as bus, contextlib.suppress(KeyboardInterrupt):
        watch_car(bus, args.name, args.seconds, operate=args.operate)
