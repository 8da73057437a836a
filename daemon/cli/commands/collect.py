"""`steerd collect`: a drive whose session identifies the car."""

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from typing import TYPE_CHECKING

from steerd.daemon.assembly.plans import NAMES, make_closed_path, parse_box
from steerd.daemon.cli.arguments import option
from steerd.daemon.cli.commands import run as driving
from steerd.daemon.common.errors import ExitCode, SteerdError, refusing
from steerd.daemon.settings.run_options import RunOptions

if TYPE_CHECKING:
    from steerd.daemon.assembly.build import RunPlan

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
    """Typed options from the command line.

    Raises:
        SteerdError: a combination makes no sense.
    """
    if args.controller != "lane":
        what = "a plan is driven by the daemon itself"
        raise SteerdError(what, "drop --controller", ExitCode.USAGE)
    parts = [args.plan, "closed" if args.closed else f"speed={args.speed:g}"]
    if args.box:
        parts.append(f"box={args.box}")
    args.path = args.path or _path(args)
    return replace(driving.make_options(args), drill=";".join(parts))


def _path(args: Namespace) -> str:
    """The lane keeper's path: a figure eight that fits the box; open loop it is not followed."""
    if not args.closed:
        return "line"
    with refusing():
        return make_closed_path(parse_box(args.box) if args.box else None)


def plan_drive(options: RunOptions, *, design: bool = True) -> "RunPlan":
    """The run of these options, as long as its plan unless they say how long.

    Raises:
        SteerdError: plan, path or car file are refused.
    """
    from steerd.daemon.assembly.build import make_plan

    plan = make_plan(options, design=design)
    if plan.drill is None or options.duration_s is not None:
        return plan
    return replace(plan, options=replace(options, duration_s=plan.drill.seconds))


def collect(args: Namespace) -> int:
    """Drive an excitation plan and record it: a session that identifies the car.

    steerd collect --sim --fast --plan mixed --record mixed.mcap
    steerd collect --plan circles --box 6 --port /dev/vesc --mocap natnet://HOST/car

    Plans: circles (the paper's: 8 left, 8 right, steering at its limit, 1 m/s),
    slalom, chirp, steps, ramp (speed grows to the limit), speeds (steps of speed),
    mixed (several of them at several speeds: start with it).
    Supervisor, watchdogs and limits are those of `steerd run`; a box is a fence.
    """
    options = make_options(args)
    return driving.drive(lambda: plan_drive(options, design=args.fast), fast=args.fast)
