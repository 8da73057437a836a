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

from steerd.daemon.cli.car_written import report_refusal
from steerd.daemon.cli.inputs import reads_car, reads_session
from steerd.daemon.cli.session_argument import (
    add_sessions,
    pick_sessions,
    split_held_out,
    split_list,
)  # fmt: skip
from steerd.daemon.common.errors import ExitCode, SteerdError

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
    what.add_argument(
        "--free",
        type=split_list,
        default=(),
        metavar="A,B,…",
        help="free parameters (default: all)",
    )
    what.add_argument(
        "--fix", type=parse_fix, default={}, metavar="A,B=VALUE,…", help="keep these as they are"
    )
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
        type=lambda text: "auto" if text == "auto" else split_list(text),
        default=(),
        metavar="auto|A,B,…",
        help="learn only these effects of the library (default, auto: all that the drives show)",
    )
    what.add_argument("--method", choices=("ours", "paper", "cma-es"), default="ours")
    what.add_argument("--starts", type=int, metavar="N", help="starts (ours: 1, others: 5)")
    what.add_argument("--iterations", type=int, metavar="N", help="of the paper's methods")
    what.add_argument("--seed", type=int, default=0, help="of random starts")
    reads_session(what.add_argument(
        "--held-out", type=split_held_out, action="extend", metavar="K|FILE,…",
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
    from steerd.daemon.analysis.identification import FIT, run_identification
    from steerd.daemon.analysis.options import IdentifyOptions, read_arguments
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import writing
    from steerd.daemon.sessions.text import print_warnings
    from steerd.posterior_file import posterior_path

    to_screen = str(args.json) == "-"
    beside = None if args.output is None else posterior_path(args.output)
    named = {"-o": args.output, "--json": None if to_screen else args.json,
             "--report": args.report, "beside -o": beside}  # fmt: skip
    with writing(named, announced=True) as write:
        paths = pick_sessions(args.sessions)
        with show_progress("identifying", len(paths) + FIT) as advance:
            options = read_arguments(IdentifyOptions, args)
            found = run_identification(paths, options, print_warnings, advance)
        result = json.dumps(found.to_json(), indent=1) + "\n"
        car, refused = None, None
        try:
            car = found.make_car(args.output) if args.output else None
        except SteerdError as error:  # a value where no car is: the rest is written all the same
            refused = error
        there = write(args.output, car.text if car else None)
        write(named["--json"], result)
        if to_screen:
            print(result, end="", flush=True)
        else:
            print(found.describe(args.output if there else None), flush=True)
        # What is on the screen is written; what takes longer is added.
        drawn = _DRAW if args.report else 0.0
        with show_progress("writing", drawn + (_NOISE if there else 0.0)) as advance:
            advance(0.0, "drawing the report" if args.report else "")
            write(args.report, found.render_report() if args.report else None)
            if car is not None and there:
                advance(drawn, "learning the noise for diagnose")
                write(beside, found.learn_known(car).posterior)
    if refused is not None:
        what = f"{args.output} is not written: {refused.what.removeprefix(f'{args.output}: ')}"
        raise SteerdError(what, "no car is like that; see the notes above", ExitCode.STOPPED)
    if car is not None:
        report_refusal(car)
    return ExitCode.OK if found.improved else ExitCode.STOPPED
