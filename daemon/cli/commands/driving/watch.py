"""A running car in a terminal: state, errors, rates and faults. Watches only; Ctrl-C leaves.

steerd watch
steerd watch --lab screen
"""

import argparse

from steerd.daemon.common.errors import ExitCode
from steerd.daemon.ipc.operator import add_bus_arguments, connect
from steerd.daemon.terminal.watch import DEPTH, SECOND, Watch, find_car
from steerd.steer_bus.bus import Subscription
from steerd.steer_bus.clock import Clock, MonotonicClock
from steerd.steer_bus.topics import make_key

REFRESH_NS = 100_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which car, and how long."""
    add_bus_arguments(parser)
    parser.add_argument("--name", help="the car's name (default: the only one on the bus)")
    parser.add_argument("--seconds", type=float, metavar="S", help="leave after so long")


def run(args: argparse.Namespace) -> int:
    """Show the car until Ctrl-C.

    Raises:
        SteerdError: no daemon or no such car is there.
    """
    from rich.console import Console
    from rich.live import Live

    from steerd.daemon.terminal.dashboard import Dashboard

    clock = MonotonicClock()
    with connect(args) as bus:
        car = find_car(bus, args.name)
        watch = Watch(Dashboard(f"steerd watch · {car}"))
        heard = bus.subscribe(make_key(car, "*"), DEPTH)
        end = None if args.seconds is None else clock.now_ns() + round(args.seconds * SECOND)
        console = Console()
        try:
            if not console.is_terminal:
                _lines(watch, heard, clock, end)
                return ExitCode.OK
            with Live(console=console, auto_refresh=False, screen=False) as live:
                while end is None or clock.now_ns() < end:
                    for sample in heard.poll():
                        watch.take(sample, clock.now_ns())
                    live.update(watch.render(clock.now_ns()), refresh=True)
                    clock.sleep_until_ns(clock.now_ns() + REFRESH_NS)
        except KeyboardInterrupt:
            pass
    return ExitCode.OK


def _lines(watch: Watch, heard: Subscription, clock: Clock, end: int | None) -> None:
    """For pipes: changes at once, a line each second."""
    due = clock.now_ns() + SECOND
    while end is None or clock.now_ns() < end:
        for sample in heard.poll():
            said = watch.take(sample, clock.now_ns())
            if said is not None:
                print(said, flush=True)
        if clock.now_ns() >= due:
            due += SECOND
            print(watch.line(clock.now_ns()), flush=True)
        clock.sleep_until_ns(clock.now_ns() + REFRESH_NS)
