"""Drive the closed loop many times in virtual time, each time another draw.

steerd sweep sweep.toml -o sweep.parquet --page sweep.html
steerd sweep sweep.toml --again 17 --record worst.mcap

The sweep file names seeds and what is varied: car parameters, effects, noise,
paths, speeds; lists are crossed, distributions are drawn for every seed. An
interrupted sweep goes on where it was when the same command is given again;
the same file gives the same bytes. `steerd sweep --example` prints a sweep
file. Exit code 3: a file cannot be read; 4: the sweep file says something
impossible.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import missing_file, option
from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.daemon.many.sweep.plan import SweepPlan

EXAMPLE = """\
# How often: every combination of the lists below, with each of these seeds.
seeds = 200          # or a list: [1, 2, 5]
duration = 20.0      # of a drive [s]
path = "figure8"
speed = 1.5          # [m/s]
# car = "car.toml"   # what the controller is designed from (default: F1TENTH's)

# What the simulated car and its drive are, instead of what the car file says.
[vary]
"car.mass" = { share = 0.05 }                  # normal, 5 % of the car file's
"car.mu" = { mean = 0.9, sd = 0.1 }
"car.c_sf" = { median = 4.7, factor = 1.2 }    # log-normal
"effect.steer_delay" = { low = 0.0, high = 0.04 }
"mocap.position_noise" = [0.0002, 0.002]       # a list is crossed
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "file", "SWEEP.toml", "what to drive", missing_file, type=Path, nargs="?")
    option(parser, "--example", "", "print a sweep file and end")
    out = parser.add_argument_group("output")
    option(out, "-o --output", "FILE.parquet", "a row for each drive", type=Path)
    option(out, "--page", "FILE.html", "one page with figures", type=Path)
    where = parser.add_argument_group("work")
    option(where, "--jobs", "N", "processes (default: one per core)", type=int, default=0)
    again = parser.add_argument_group("one drive of it")
    option(again, "--again", "N", "drive number N alone", type=int)
    option(again, "--record", "FILE.mcap", "session file of that drive", type=Path)


def run(args: argparse.Namespace) -> None:
    if args.example:
        print(EXAMPLE, end="")
        return
    _check(args)
    from steerd.daemon.many.job import do_in_terminal
    from steerd.daemon.many.sweep.plan import load_sweep
    from steerd.daemon.many.sweep.run import make_job
    from steerd.daemon.many.units import Where

    plan = load_sweep(args.file)
    if args.again is not None:
        _drive_again(plan, args)
    else:
        do_in_terminal(make_job(plan), Where(args.jobs), args.output, args.page)


def _check(args: argparse.Namespace) -> None:
    """Refuse what makes no sense before anything heavy is loaded."""
    from steerd.daemon.common.written import check_outputs

    if args.file is None:
        hint = "steerd sweep --example > sweep.toml"
        raise SteerdError("a sweep file is needed", hint, ExitCode.USAGE)
    check_outputs({"-o": args.output, "--page": args.page})
    if (args.again is None) != (args.record is None):
        raise SteerdError("--again and --record go together", "name both", ExitCode.USAGE)


def _drive_again(plan: "SweepPlan", args: argparse.Namespace) -> None:
    """Drive one case of the sweep and record it."""
    from steerd.daemon.common.screen import NBSP, wrap
    from steerd.daemon.many.sweep.drive import prepare
    from steerd.daemon.many.sweep.run import find_case
    from steerd.daemon.offline.fast import check_driven, record_virtual
    from steerd.daemon.offline.virtual import drive
    from steerd.sim_hw.world import World

    case = find_case(plan, args.again)
    run_plan, config = prepare(plan, case)
    drawn = ", ".join(
        f"{name}{NBSP}{value if isinstance(value, str) else format(value, '.4g')}"
        for name, value in case.values.items()
    )
    head = f"drive {case.number}: "
    print("\n".join(wrap(f"seed {case.seed}{', ' if drawn else ''}{drawn}", head, " " * 4)))
    run = record_virtual(run_plan, args.record, drive, world=World(config))
    if run.core.loop.faulted:
        print(f"stopped: {run.core.loop.fault}")
    check_driven(run)
    print(f"written: {args.record}\n   next: steerd plot {args.record}")
