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
import json
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.car_written import report_refusal
from steerd.daemon.cli.inputs import reads_car, reads_session
from steerd.daemon.cli.session_argument import add_sessions, pick_sessions
from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.daemon.analysis.identify_case import IdentifyRequest

_DRAW, _NOISE = 1.0, 8.0
"""About what the report's figures and the noise cost, in sessions read."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd identify`."""
    add_sessions(parser)
    what = parser.add_argument_group("what is learnt")
    reads_car(
        what.add_argument("--car", type=Path, metavar="FILE.toml", help="start values (F1TENTH's)")
    )
    what.add_argument("--base", dest="car", type=Path, help=argparse.SUPPRESS)
    what.add_argument("--free", metavar="A,B,…", help="free parameters (default: all eleven)")
    what.add_argument("--fix", default="", metavar="A,B=VALUE,…", help="keep these as they are")
    what.add_argument(
        "--wheelbase", type=float, metavar="M", help="distance of the axles, measured"
    )
    what.add_argument(
        "--speed",
        choices=("command", "wheel"),
        default="command",
        help="wheel: the speed command was not obeyed, take the measured speed instead",
    )
    what.add_argument(
        "--effects",
        metavar="auto|A,B,…",
        help="learn only these effects of the library (default, auto: all that the drives show)",
    )
    what.add_argument("--method", choices=("ours", "paper", "cma-es"), default="ours")
    what.add_argument("--starts", type=int, metavar="N", help="starts (ours: 1, others: 5)")
    what.add_argument("--iterations", type=int, metavar="N", help="of the paper's methods")
    what.add_argument("--seed", type=int, default=0, help="of random starts")
    reads_session(what.add_argument(
        "--held-out", action="append", default=[], metavar="K|FILE,…",
        help="validate on every K-th block of 5 s (default 4), or on these sessions",
    ))  # fmt: skip
    out = parser.add_argument_group("output")
    out.add_argument("-o", "--output", type=Path, metavar="CAR.toml", help="car file to write")
    out.add_argument(
        "--json", type=Path, metavar="FILE", help="the result for programs; -: to the terminal"
    )
    out.add_argument("--report", type=Path, metavar="FILE.html", help="the result with figures")
    where = parser.add_argument_group("where")
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    where.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler instead")


def make_request(args: argparse.Namespace) -> "IdentifyRequest":
    """Typed values of the command line.

    Raises:
        SteerdError: the car file or an option cannot be used.
    """
    from steerd.daemon.analysis.held_out import parse_held_out, split_list
    from steerd.daemon.analysis.identify_case import IdentifyRequest
    from steerd.daemon.analysis.sources import read_car

    effects = args.effects or ""
    return IdentifyRequest(
        sessions=tuple(pick_sessions(args.sessions)),
        car=read_car(args.car),
        held_out=parse_held_out(args.held_out),
        free=tuple(split_list([args.free or ""])),
        fix=parse_fix(args.fix),
        wheelbase=args.wheelbase,
        speed=args.speed,
        effects="auto" if effects == "auto" else tuple(split_list([effects])),
        method=args.method,
        starts=args.starts,
        iterations=args.iterations,
        seed=args.seed,
        jobs=args.jobs,
        dask=args.dask,
    )


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
    """Identify, print, write.

    Raises:
        SteerdError: a session, the car file or an option cannot be used, or a file not be written.
    """
    from steerd.daemon.analysis.identification import FIT_WORK, run_identification
    from steerd.daemon.analysis.identify_text import describe
    from steerd.daemon.assembly.sim_car import read_sim_option
    from steerd.daemon.common.outputs import check_outputs
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import write_outputs
    from steerd.daemon.sessions.text import print_warnings
    from steerd.steer_bus.session_read import open_session

    to_screen = str(args.json) == "-"
    named = None if to_screen else args.json
    check_outputs({"-o": args.output, "--json": named, "--report": args.report})
    request = make_request(args)
    fitted = len(request.sessions) + len(request.held_out.files) + FIT_WORK
    with show_progress("identifying", fitted) as advance:
        found = run_identification(request, print_warnings, advance)
    result = json.dumps(found.to_json(), indent=1) + "\n"
    if to_screen:
        print(result, end="", flush=True)
    else:
        measured = request.wheelbase is not None
        again = read_sim_option(open_session(request.sessions[0]).info().metadata)
        screen = describe(found.outcome, args.output, axles_measured=measured, sim_option=again)
        print(screen, flush=True)
    # What follows may fail, for want of space for instance; the result is on the screen by then.
    drawn = _DRAW if args.report else 0.0
    with show_progress("writing", drawn + (_NOISE if args.output else 0.0)) as advance:
        advance(0.0, "drawing the report" if args.report else "")
        report = found.render_report() if args.report else None
        advance(drawn, "learning the noise for diagnose" if args.output else "")
        car = None
        refused: SteerdError | None = None
        try:
            car = found.make_car_text(args.output) if args.output else None
        except SteerdError as error:  # a value where no car is: the rest is written all the same
            refused = error
    write_outputs({args.report: report, named: result, args.output: car}, announced=True)
    if refused is not None:
        what = f"{args.output} is not written: {refused.what.removeprefix(f'{args.output}: ')}"
        raise SteerdError(what, "no car is like that; see the notes above", ExitCode.STOPPED)
    if car is not None:
        report_refusal(args.output)
    return ExitCode.OK if found.improved else ExitCode.STOPPED
