"""Simulated hardware alone: a VESC on a pseudo-terminal and a mocap server.

Any VESC program, or `steerd run --port … --mocap …`, can use what it prints.
Enter pushes the car 1 m forward, as `steerd mocap check` wants it, and the next
time back. Ctrl-C ends it.
"""

import argparse
import sys
from pathlib import Path

from steerd.daemon.cli.arguments import missing_car, option
from steerd.daemon.common.errors import refusing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    text = "the simulated car (default: F1TENTH's figures; hidden: one that the seed hides)"
    option(parser, "--car", "FILE.toml|hidden:SEED", text, missing_car)
    text = "protocol of its server"
    option(parser, "--mocap", None, text, choices=("natnet", "vrpn"), default="natnet")
    option(parser, "--effect", "NAME=VALUE,…", "of the simulated car", action="append")
    text = "a fault, from and to in seconds after the start"
    option(parser, "--fault", "NAME[@FROM[-TO]]", text, action="append")
    option(parser, "--seed", None, "of its noise", type=int, default=0)
    option(parser, "--link-dir", None, "where the serial port's name is made", type=Path)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.assembly.build import make_plan, make_world_config
    from steerd.daemon.common.screen import wrap_command
    from steerd.daemon.settings.run_options import RunOptions
    from steerd.sim_hw.real_time import links

    options = RunOptions(
        "", path="line", seed=args.seed, simulated=True, effects=tuple(args.effect),
        sim_car=args.car or "",
    )  # fmt: skip
    world = make_world_config(make_plan(options, design=False), args.mocap)
    with refusing("--fault: "):
        faults = links.fault_windows(args.fault)
    links.raise_priority()
    with links.stop_on_signals() as stop, links.SimHardware(world, faults, args.link_dir) as sim:
        print(f"VESC:  {sim.port}")
        print(f"mocap: {sim.mocap_url}")
        command = f"steerd run --port {sim.port} --mocap '{sim.mocap_url}'"
        shown = wrap_command(command, "   try: ", " " * 10)
        print("", *(shown if sys.stdout.isatty() else [f"   try: {command}"]), sep="\n", flush=True)
        sim.run(stop, (0,) if sys.stdin.isatty() else ())
