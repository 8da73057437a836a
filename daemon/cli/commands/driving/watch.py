"""A running car in a terminal: state, errors, rates and faults. Ctrl-C leaves.

steerd watch
steerd watch --lab screen
steerd watch --operate      # arm, start and stop here too; it holds the car

Keys change live parameters: the highest speed, a lane beside the path, a share
of the feedback. The car refuses those of anybody but the operator who holds it.
"""

import argparse
import sys
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import add_bus_arguments, option
from steerd.daemon.common.errors import ExitCode

if TYPE_CHECKING:
    from steerd.daemon.terminal.watch import Watch
    from steerd.steer_bus.bus import Subscription
    from steerd.steer_bus.clock import Clock

REFRESH_NS = 100_000_000  # time between two refreshes [ns]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bus_arguments(parser)
    option(parser, "--name", None, "the car's name (default: the only one on the bus)")
    option(parser, "--operate", "", "keys arm, start and stop: closing this stops it")
    option(parser, "--seconds", "S", "leave after this time", type=float)


def run(args: argparse.Namespace) -> int:
    from steerd.daemon.ipc.operator import connect, read_lab

    if args.lab is not None:
        read_lab(args.lab)  # a folder that is none is refused before anything heavy is loaded
    from rich.console import Console
    from rich.live import Live

    from steerd.daemon.common.screen import raw
    from steerd.daemon.process.bus_operator import REPEAT_NS
    from steerd.daemon.terminal.dashboard import Dashboard
    from steerd.daemon.terminal.key_desk import KEY_HELP, NUDGE_HELP, keys_one_by_one, wait_for_key
    from steerd.daemon.terminal.watch import DEPTH, SECOND, Watch, find_car, make_desk
    from steerd.steer_bus.clock import MonotonicClock
    from steerd.steer_bus.topics import make_key

    clock = MonotonicClock()
    with connect(args.connect, args.lab) as bus:
        car = find_car(bus, args.name)
        watch = Watch(Dashboard(f"steerd watch · {car}"))
        received = bus.subscribe(make_key(car, "*"), DEPTH)
        end = None if args.seconds is None else clock.now_ns() + round(args.seconds * SECOND)
        console = Console(file=raw(sys.stdout))
        try:
            if not console.is_terminal:
                _print_lines(watch, received, clock, end)
                return ExitCode.OK
            desk, repeat = make_desk(watch.board, bus, car, clock, operate=args.operate)
            with keys_one_by_one() as keys, Live(console=console, auto_refresh=False) as live:
                help_text = f"{KEY_HELP}\n{NUDGE_HELP}" if args.operate else NUDGE_HELP
                watch.board.keys = "" if keys is None else help_text
                shown_ns = 0
                while end is None or clock.now_ns() < end:
                    for sample in received.poll():
                        watch.take(sample, clock.now_ns())
                    if (now := clock.now_ns()) - shown_ns >= REFRESH_NS:
                        shown_ns = now
                        live.update(watch.render(now), refresh=True)
                    desk.keep_alive()
                    repeat()
                    for key in wait_for_key(keys, REPEAT_NS, clock):
                        desk.on_key(key)
        except KeyboardInterrupt:
            pass
    return ExitCode.OK


def _print_lines(watch: "Watch", received: "Subscription", clock: "Clock", end: int | None) -> None:
    """For pipes: transitions at once, one line per second."""
    from steerd.daemon.terminal.watch import SECOND

    due = clock.now_ns() + SECOND
    while end is None or clock.now_ns() < end:
        for sample in received.poll():
            line = watch.take(sample, clock.now_ns())
            if line is not None:
                print(line, flush=True)
        if clock.now_ns() >= due:
            due += SECOND
            print(watch.line(clock.now_ns()), flush=True)
        clock.sleep_until_ns(clock.now_ns() + REFRESH_NS)
