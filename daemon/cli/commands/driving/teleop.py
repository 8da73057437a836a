"""Drive by gamepad: an external controller with a deadman's button.

For `steerd run --controller zenoh`, which applies the commands through the
same limits as any other. Hold the deadman (left shoulder button) all the time:
press start to arm, start again to drive; the right trigger is the speed, the
left stick steers, B is the emergency stop. Letting go, unplugging the gamepad,
or the end of this command stops the car. A gamepad that sends no event for 2 s
counts as released: a wireless one may be out of reach.

steerd teleop --speed 1.5
steerd teleop --device /dev/input/event5 --speed-axis y
"""

import argparse
import sys
from pathlib import Path

from steerd.daemon.cli.arguments import add_car_arguments, option
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.signals import raise_on_stop_signals
from steerd.daemon.process.gamepad import AXES, BUTTONS, PadMap

QUIET_MOST_S = 10.0  # longest silence of a gamepad that may count as held [s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_car_arguments(parser)
    text = "gamepad, or a pipe of its events (default: the only one)"
    option(parser, "--device", "DEV", text, type=Path)
    option(parser, "--speed", "M/S", "at the axis's end (default 1)", type=float, default=1.0)
    option(parser, "--steer", "RAD", "at the axis's end (default 0.34)", type=float, default=0.34)
    for name, known, usual, what in (
        ("--deadman", BUTTONS, "tl", "button that is held to drive"),
        ("--speed-axis", AXES, "rz", "a trigger, or a stick that is pushed"),
        ("--steer-axis", AXES, "x", "a stick"),
    ):
        text = f"{what}: {', '.join(known)} (default {usual})"
        option(parser, name, "NAME", text, choices=list(known), default=usual)
    text = "a gamepad without events for so long is released (default 2)"
    option(parser, "--quiet", "S", text, type=float, default=2.0)


def run(args: argparse.Namespace) -> None:
    from steerd.controller.limits import CEILINGS

    highest = (CEILINGS["speed_max"].high, CEILINGS["steer_left_max"].high, QUIET_MOST_S)
    for name, most in zip(("speed", "steer", "quiet"), highest, strict=True):
        if not 0.0 < getattr(args, name) <= most:
            what = f"--{name} {getattr(args, name):g}: more than 0, at most {most:g}"
            raise SteerdError(what, "", ExitCode.USAGE)
    from steerd.daemon.ipc.operator import connect, read_status
    from steerd.daemon.process.gamepad import PadGoneError, open_pad
    from steerd.daemon.process.page_link import CarView
    from steerd.daemon.process.teleop import Teleop, serve_pad
    from steerd.steer_bus.clock import MonotonicClock

    raise_on_stop_signals()
    pads = PadMap(
        deadman=BUTTONS[args.deadman],
        steer=args.steer_axis,
        speed=args.speed_axis,
        steer_max=args.steer,
        speed_max=args.speed,
        quiet_ns=round(args.quiet * 1e9),
    )
    pad = open_pad(args.device, pads.deadman)
    clock = MonotonicClock()
    with connect(args.connect, args.lab, "steerd run --controller zenoh") as bus:
        status = read_status(bus, args.name, clock)
        if status.get("controller") != "remote":
            what = f"{args.name} follows its lane, not a gamepad"
            raise SteerdError(what, "start it with --controller zenoh", ExitCode.STOPPED)
        teleop = Teleop(CarView(bus, args.name, clock), pads, pad.axes)
        print(f"{pad.name}: hold {args.deadman}, then start; Ctrl-C ends", file=sys.stderr)
        try:
            serve_pad(teleop, pad, clock, lambda line: print(line, file=sys.stderr, flush=True))
        except KeyboardInterrupt:
            pass
        except PadGoneError:
            what = f"{pad.name} is gone; the car stops"
            raise SteerdError(what, "plug it in again", ExitCode.UNREADABLE) from None
        finally:
            if teleop.pad.held:
                teleop.release()
            pad.close()
