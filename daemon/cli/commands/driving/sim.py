"""Simulated hardware alone: a VESC on a pseudo-terminal and a mocap server.

Any VESC program, or `steerd run --port … --mocap …`, can use what it prints.
Ctrl-C ends it.
"""

import argparse
import sys
from pathlib import Path

from steerd.daemon.cli.inputs import reads_car
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd sim`."""
    reads_car(parser.add_argument(
        "--car", metavar="FILE.toml|hidden:SEED",
        help="the simulated car (default: F1TENTH's figures; hidden: one that the seed hides)",
    ))  # fmt: skip
    parser.add_argument("--mocap", choices=("natnet", "vrpn"), default="natnet")
    parser.add_argument("--effect", action="append", default=[], metavar="NAME=VALUE,…")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[@FROM[-TO]]",
        help="a fault, from and to in seconds after the start",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--link-dir", type=Path, help="where the serial port's name is made")


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    from steerd.daemon.assembly.build import make_plan, make_world_config
    from steerd.daemon.common.screen import wrap_command
    from steerd.daemon.settings.run_options import RunOptions
    from steerd.sim_hw.real_time.links import (
        SimHardware,
        SimOptions,
        fault_windows,
        raise_priority,
        stop_on_signals,
    )

    options = RunOptions(
        "",
        simulated=True,
        seed=args.seed,
        effects=tuple(args.effect),
        path="line",
        sim_car=args.car or "",
    )
    world = make_world_config(make_plan(options, design=False), args.mocap)
    try:
        faults = fault_windows(args.fault)
    except ValueError as error:
        raise SteerdError(f"--fault: {error}", "", ExitCode.USAGE) from None
    raise_priority()
    with stop_on_signals() as stop, SimHardware(world, SimOptions(faults, args.link_dir)) as sim:
        print(f"VESC:  {sim.port}")
        print(f"mocap: {sim.mocap_url}")
        command = f"steerd run --port {sim.port} --mocap '{sim.mocap_url}'"
        shown = wrap_command(command, "   try: ", " " * 10)
        print("", *(shown if sys.stdout.isatty() else [f"   try: {command}"]), sep="\n", flush=True)
        sim.run(stop)
    return ExitCode.OK
