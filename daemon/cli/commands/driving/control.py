"""The lane keeper as a process of its own: estimates in, commands out, over zenoh.

For `steerd run --controller zenoh`, which applies the commands through the same
limits and stops the car when they are too old.
"""

import argparse
import contextlib
import secrets
import sys

from steerd.daemon.cli.arguments import add_bus_arguments
from steerd.daemon.cli.commands.driving.run import add_drive_arguments
from steerd.daemon.ipc.signals import raise_on_stop_signals


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bus_arguments(parser)
    add_drive_arguments(parser)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.assembly.build import make_plan
    from steerd.daemon.ipc.operator import connect, read_status
    from steerd.daemon.process.external_controller import ExternalController, answer, keep_lane
    from steerd.daemon.settings.run_options import RunOptions
    from steerd.steer_bus.clock import MonotonicClock

    raise_on_stop_signals()
    options = RunOptions(
        args.car or "", args.name, path=args.path, speed=args.speed, rate_hz=args.rate
    )
    plan = make_plan(options)
    clock = MonotonicClock()
    with connect(args.connect, args.lab, "steerd run --controller zenoh") as bus:
        status = read_status(bus, args.name, clock)
        boot_id = int(status["boot_id"])
        keeper = ExternalController(keep_lane(plan.controller), boot_id, secrets.randbits(62) + 1)
        print(f"steering {args.name} along {plan.path.name}; Ctrl-C ends", file=sys.stderr)
        end = None if args.duration is None else clock.now_ns() + round(args.duration * 1e9)
        with contextlib.suppress(KeyboardInterrupt):
            answer(bus, args.name, keeper, clock, end)
