"""Programs beside a running car: screen, page, lane keeper, gamepad, and simulated hardware."""

import asyncio
import contextlib
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from steerd.controller.limits import CEILINGS
from steerd.daemon.cli.arguments import add_bus_arguments, add_car_arguments, missing_car, option
from steerd.daemon.cli.commands.run import add_drive_arguments
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, refusing
from steerd.daemon.common.screen import wrap_command
from steerd.daemon.ipc.signals import make_stop_signal_pipe, raise_on_stop_signals
from steerd.daemon.process.gamepad import AXES, BUTTONS, PadGoneError, PadMap, open_pad
from steerd.daemon.process.view_job import make_lane_job
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus.clock import MonotonicClock

QUIET_MOST_S = 10.0  # longest silence of a gamepad that may count as held [s]


def watch_arguments(parser: ArgumentParser) -> None:
    add_bus_arguments(parser)
    option(parser, "--name", None, "the car's name (default: the only one on the bus)")
    option(parser, "--operate", "", "keys arm, start and stop: closing this stops it")
    option(parser, "--seconds", "S", "leave after this time", type=float)


def watch(args: Namespace) -> None:
    """A running car in a terminal: state, errors, rates and faults. Ctrl-C leaves.

    steerd watch
    steerd watch --lab screen
    steerd watch --operate      # arm, start and stop here too; it holds the car

    Keys change live parameters: the highest speed, a lane beside the path, a share
    of the feedback. The car refuses those of anybody but the operator who holds it.
    """
    from steerd.daemon.process.bus_operator import connect

    with connect(args.connect, args.lab) as bus, contextlib.suppress(KeyboardInterrupt):
        from steerd.daemon.terminal.watch import watch_car  # the heavy one, of a car that is there

        watch_car(bus, args.name, args.seconds, operate=args.operate)


def page_arguments(parser: ArgumentParser) -> None:
    add_car_arguments(parser)
    option(parser, "--path", None, "the lane to draw, as --path of run")
    option(parser, "--port", "N", "of the page (default: a free one)", type=int, default=0)


def page(args: Namespace) -> None:
    """A running car as a live page in a browser on this machine.

    steerd page
    steerd page --lab console          # the car is elsewhere, in the lab

    The page shows track, lane, errors, speed, battery and what the car waits for.
    Whoever arms the car there holds it: close or leave the page and it stops.
    `steerd run --page` starts the same for its own car.
    """
    from steerd.daemon.process.bus_operator import CarView, connect

    def on_open(url: str) -> None:
        print(f"page: {url}", flush=True)
        print("open it in a browser on this machine; Ctrl-C ends it", file=sys.stderr)

    with connect(args.connect, args.lab) as bus:
        from steerd.daemon.process.page import make_page, run_page  # the heavy one

        content = make_page(args.name, make_lane_job(args.path))
        view = CarView(bus, args.name, MonotonicClock())
        try:
            asyncio.run(run_page(view, content, args.port, on_open, asyncio.Event()))
        except KeyboardInterrupt:
            pass
        except OSError as error:
            what = f"--port {args.port}: {error.strerror or error}"
            raise SteerdError(what, "name another port", ExitCode.UNREACHABLE) from None


def control_arguments(parser: ArgumentParser) -> None:
    add_bus_arguments(parser)
    add_drive_arguments(parser)


def control(args: Namespace) -> None:
    """The lane keeper as a process of its own: estimates in, commands out, over zenoh.

    For `steerd run --controller zenoh`, which applies the commands through the same
    limits and stops the car when they are too old.
    """
    from steerd.daemon.assembly.build import make_plan
    from steerd.daemon.process.bus_operator import CarView, connect
    from steerd.daemon.process.external_controller import answer, keep_lane

    raise_on_stop_signals()
    options = RunOptions(
        args.car or "", args.name, path=args.path, speed=args.speed, rate_hz=args.rate
    )
    plan = make_plan(options)
    with connect(args.connect, args.lab, "steerd run --controller zenoh") as bus:
        view = CarView(bus, args.name, MonotonicClock()).wait_heard()
        print(f"steering {args.name} along {plan.path.name}; Ctrl-C ends", file=sys.stderr)
        with contextlib.suppress(KeyboardInterrupt):
            answer(view, keep_lane(plan.controller), args.duration)


def teleop_arguments(parser: ArgumentParser) -> None:
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


def teleop(args: Namespace) -> None:
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
    highest = (CEILINGS["speed_max"].high, CEILINGS["steer_left_max"].high, QUIET_MOST_S)
    for name, most in zip(("speed", "steer", "quiet"), highest, strict=True):
        if not 0.0 < getattr(args, name) <= most:
            raise UsageError(f"--{name} {getattr(args, name):g}: more than 0, at most {most:g}")
    from steerd.daemon.process.bus_operator import CarView, connect
    from steerd.daemon.process.teleop import Teleop, serve_pad

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
        view = CarView(bus, args.name, clock).wait_heard()
        if view.values.get("controller") != "remote":
            what = f"{args.name} follows its lane, not a gamepad"
            raise SteerdError(what, "start it with --controller zenoh", ExitCode.STOPPED)
        teleop = Teleop(view, pads, pad.axes)
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


def sim_arguments(parser: ArgumentParser) -> None:
    text = "the simulated car (default: F1TENTH's figures; hidden: one that the seed hides)"
    option(parser, "--car", "FILE.toml|hidden:SEED", text, missing_car)
    text = "protocol of its server"
    option(parser, "--mocap", None, text, choices=("natnet", "vrpn"), default="natnet")
    option(parser, "--effect", "NAME=VALUE,…", "of the simulated car", action="append")
    text = "a fault, from and to in seconds after the start"
    option(parser, "--fault", "NAME[@FROM[-TO]]", text, action="append")
    option(parser, "--seed", None, "of its noise", type=int, default=0)
    option(parser, "--link-dir", None, "where the serial port's name is made", type=Path)


def sim(args: Namespace) -> None:
    """Simulated hardware alone: a VESC on a pseudo-terminal and a mocap server.

    Any VESC program, or `steerd run --port … --mocap …`, can use what it prints.
    Enter pushes the car 1 m forward, as `steerd mocap check` wants it, and the next
    time back. Ctrl-C ends it.
    """
    from steerd.daemon.assembly.build import make_plan, make_world_config
    from steerd.sim_hw.real_time import links

    options = RunOptions(
        "", path="line", seed=args.seed, simulated=True, effects=tuple(args.effect),
        sim_car=args.car or "",
    )  # fmt: skip
    world = make_world_config(make_plan(options, design=False), args.mocap)
    with refusing("--fault: "):
        faults = links.fault_windows(args.fault)
    links.raise_priority()
    stop = make_stop_signal_pipe()
    with links.SimHardware(world, faults, args.link_dir) as hw:
        print(f"VESC:  {hw.port}")
        print(f"mocap: {hw.mocap_url}")
        command = f"steerd run --port {hw.port} --mocap '{hw.mocap_url}'"
        shown = wrap_command(command, "   try: ", " " * 10)
        print("", *(shown if sys.stdout.isatty() else [f"   try: {command}"]), sep="\n", flush=True)
        hw.run(stop, (0,) if sys.stdin.isatty() else ())
