"""Identify a car from sessions: parameters with error bars, and a car file.

steerd identify drive1.mcap drive2.mcap -o car.toml --report identify.html
steerd identify *.mcap --wheelbase 0.324 --fix mass=3.2 --held-out last.mcap

What is not identifiable from the data is named, with the manoeuvre that would
identify it. Values are validated on held-out drives (or blocks of 5 s). Exit
code 3: a file cannot be read; 4: its content is not fit for identification; 5:
the result predicts no better than the start values.
"""

# Why: docs/decisions/identification.md#d32

import argparse
from pathlib import Path
from typing import Any

from steerd.daemon.cli import arguments
from steerd.daemon.cli.arguments import missing_car, option, split_list
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    arguments.add_sessions(parser)
    what = parser.add_argument_group("what is learnt")
    option(what, "--car", "FILE.toml", "start values (F1TENTH's)", missing_car, type=Path)
    option(what, "--base", None, argparse.SUPPRESS, dest="car", type=Path)
    option(what, "--free", "A,B,…", "free parameters (default: all)", type=split_list, default=())
    option(what, "--fix", "A,B=VALUE,…", "keep these as they are", type=parse_fix, default={})
    option(what, "--wheelbase", "M", "distance of the axles, measured", type=float)
    text = "wheel: the speed command was not obeyed, take the measured speed instead"
    option(what, "--speed", None, text, choices=("command", "wheel"), default="command")
    text = "learn only these effects of the library (default, auto: all that the drives show)"
    effects: dict[str, Any] = {"type": lambda t: t if t == "auto" else split_list(t), "default": ()}
    option(what, "--effects", "auto|A,B,…", text, **effects)
    text = "our own, or one of the paper's"
    option(what, "--method", None, text, choices=("ours", "paper", "cma-es"), default="ours")
    option(what, "--starts", "N", "starts (ours: 1, others: 5)", type=int)
    option(what, "--iterations", "N", "of the paper's methods", type=int)
    option(what, "--seed", None, "of random starts", type=int, default=0)
    text = "validate on every K-th block of 5 s (default 4), or on these sessions"
    more: dict[str, Any] = {"type": arguments.split_held_out, "action": "extend"}
    option(what, "--held-out", "K|FILE,…", text, arguments.missing_session, **more)
    out = parser.add_argument_group("output")
    option(out, "-o --output", "CAR.toml", "car file to write", type=Path)
    option(out, "--json", "FILE", "the result for programs; -: to the terminal", type=Path)
    option(out, "--report", "FILE.html", "the result with figures", type=Path)
    where = parser.add_argument_group("where")
    option(where, "--jobs", "N", "processes", type=int, default=1)
    option(where, "--dask", "ADDRESS", "a Dask scheduler instead")


def parse_fix(text: str) -> dict[str, float | None]:
    """The values of `--fix` by name; None where a name stands alone.

    Raises:
        SteerdError: a value is no number.
    """
    fixed: dict[str, float | None] = {}
    for part in (p for p in text.split(",") if p):
        name, equals, number = part.partition("=")
        try:
            fixed[name] = float(number) if equals else None
        except ValueError:
            raise SteerdError(f"--fix {part}: not a number", "", ExitCode.USAGE) from None
    return fixed


def run(args: argparse.Namespace) -> int:
    from steerd.daemon.analysis.identification import FIT, IdentifyOptions, run_identification
    from steerd.daemon.analysis.options import read_arguments
    from steerd.daemon.assembly.build import report_refusal
    from steerd.daemon.cli.results import list_outputs, present
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import writing
    from steerd.daemon.sessions.text import print_warnings

    with writing(list_outputs(args), announced=True) as write:
        paths = arguments.pick_sessions(args.sessions)
        with show_progress("identifying", len(paths) + FIT) as advance:
            options = read_arguments(IdentifyOptions, args)
            found = run_identification(paths, options, print_warnings, advance)
        car = present(found, args, write)
    if car is not None:
        report_refusal(car)
    return ExitCode.OK if found.improved else ExitCode.STOPPED
