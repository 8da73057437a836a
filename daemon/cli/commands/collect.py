"""`steerd collect`: a drive whose session identifies the car."""

from argparse import ArgumentParser, Namespace
from dataclasses import replace

from steerd.daemon.assembly.plans import NAMES, make_closed_path, parse_box
from steerd.daemon.cli.arguments import option
from steerd.daemon.cli.commands import run as driving
from steerd.daemon.common.errors import UsageError, refusing
from steerd.daemon.settings.run_options import RunOptions

SPEED = 2.5  # highest speed of a plan unless said otherwise [m/s]
FIRST_OPTIONS = ("--plan", "--closed", "--box", *driving.FIRST_OPTIONS)


def collect_arguments(parser: ArgumentParser) -> None:
    what = parser.add_argument_group("plan")
    option(what, "--plan", None, "what to drive", choices=NAMES, default="mixed")
    text = "add the plan to the lane keeper's commands, along --path (default: open loop)"
    option(what, "--closed", "", text)
    text = "where the car must stay [m]; start in the middle, heading along x"
    option(what, "--box", "SIDE|X0,Y0,X1,Y1", text)
    driving.run_arguments(parser)
    parser.set_defaults(speed=SPEED, path=None)


def make_options(args: Namespace) -> RunOptions:
    """Typed options from the command line. Raises SteerdError: a combination makes no sense."""
    if args.controller != "lane":
        raise UsageError("a plan is driven by the daemon itself", "drop --controller")
    parts = [args.plan, "closed" if args.closed else f"speed={args.speed:g}"]
    if args.box:
        parts.append(f"box={args.box}")
    if not args.path and args.closed:
        with refusing():
            args.path = make_closed_path(parse_box(args.box) if args.box else None)
    args.path = args.path or "line"  # which is not followed in open loop
    return replace(driving.make_options(args), drill=";".join(parts))


def collect(args: Namespace) -> int:
    """Drive an excitation plan and record it: a session that identifies the car.

    steerd collect --sim --fast --plan mixed --record mixed.mcap
    steerd collect --plan circles --box 6 --port /dev/vesc --mocap natnet://HOST/car

    Plans: circles (the paper's: 8 left, 8 right, steering at its limit, 1 m/s),
    slalom, chirp, steps, ramp (speed grows to the limit), speeds (steps of speed),
    mixed (several of them at several speeds: start with it).
    Supervisor, watchdogs and limits are those of `steerd run`; a box is a fence.
    """
    return driving.drive(make_options(args), fast=args.fast)
