"""Where simulation and car differ, the effect that causes it, and its benefit.

steerd diagnose drive.mcap --report gap.html
steerd diagnose *.mcap --base car.toml --held-out last.mcap -o better.toml
steerd diagnose drive.mcap --healthy before.mcap --json gap.json

Candidates are compared on one footing, the base's parameters free within their
uncertainty, and scored on windows that their fits did not see. The predicted
shrinkage is written and hashed before the held-out drives are opened. Exit code
3: a file cannot be read; 4: a gap is not identifiable from its content; 5: the
base car's simulation diverges.
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

from steerd.daemon.cli.car_written import report_refusal
from steerd.daemon.cli.inputs import reads_car, reads_session
from steerd.daemon.cli.session_argument import (
    add_sessions,
    pick_sessions,
    split_held_out,
    split_paths,
)  # fmt: skip
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd diagnose`."""
    add_sessions(parser)
    what = parser.add_argument_group("what is compared")
    reads_car(what.add_argument(
        "--base", type=Path, metavar="CAR.toml",
        help="the car as identified (default: the car file inside the session)",
    ))  # fmt: skip
    what.add_argument("--car", dest="base", type=Path, help=argparse.SUPPRESS)
    reads_session(what.add_argument(
        "--healthy", type=split_paths, action="extend", default=[], metavar="FILE,…",
        help="drives of the same car without the gap: they determine how large noise is",
    ))  # fmt: skip
    what.add_argument(
        "--only", action="append", default=[], metavar="EFFECT", help="look at this one (repeat)"
    )
    what.add_argument(
        "--without", action="append", default=[], metavar="EFFECT", help="leave it out (repeat)"
    )
    what.add_argument(
        "--no-pairs", dest="pairs", action="store_false", help="one cause at most; faster"
    )
    what.add_argument(
        "--speed",
        choices=("command", "wheel"),
        default="command",
        help="wheel: the speed command was not obeyed, take the measured speed instead",
    )
    reads_session(what.add_argument(
        "--held-out", type=split_held_out, action="extend", metavar="K|FILE,…",
        help="measure the shrinkage on every K-th drive (default 4; 0: none), or on these files",
    ))  # fmt: skip
    what.add_argument(
        "--runs-held-out", dest="held_out", type=split_held_out, action="extend",
        help=argparse.SUPPRESS,
    )  # until 0.1  # fmt: skip
    out = parser.add_argument_group("output")
    out.add_argument(
        "--json", nargs="?", const="-", metavar="FILE", help="for programs; alone: to the terminal"
    )
    out.add_argument("--report", type=Path, metavar="FILE.html", help="one page, plots first")
    out.add_argument(
        "-o", "--output", type=Path, metavar="CAR.toml", help="the base with the found effect"
    )
    out.add_argument(
        "--prediction", type=Path, metavar="FILE", help="the prediction, before it is measured"
    )
    out.add_argument(
        "--no-closed-loop",
        dest="closed_loop",
        action="store_false",
        help="do not drive the session's lane again",
    )
    where = parser.add_argument_group("where")
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="candidates side by side")


def run(args: argparse.Namespace) -> int:
    """Diagnose, print, write.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    from steerd.daemon.analysis.diagnosis import DRIVEN, run_diagnosis
    from steerd.daemon.analysis.options import DiagnoseOptions, read_arguments
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import car_outputs, writing
    from steerd.daemon.sessions.text import print_warnings

    named = _named_outputs(args)
    with writing(named, announced=True) as write:

        def foretell(text: str) -> None:
            """The prediction's digest, and the prediction itself, before anything is measured."""
            digest = hashlib.sha256(text.encode()).hexdigest()
            print(f"predicted before measuring: sha256 {digest}", file=sys.stderr)
            write(args.prediction, text)

        options, paths = read_arguments(DiagnoseOptions, args), pick_sessions(args.sessions)
        with show_progress("diagnosing", 1.0) as advance:
            found = run_diagnosis(paths, options, print_warnings, advance, foretell)
            advance(DRIVEN, "")
            text = json.dumps(found.to_json(), indent=1) + "\n"
        car = found.make_car(args.output) if args.output else None
        there = [write(*each) for each in (car_outputs(args.output, car) if car else {}).items()]
        write(named["--json"], text)
        if args.json == "-":
            print(text, end="", flush=True)
        else:
            print(found.describe(args.output if any(there) else None, args.report), flush=True)
        # What is on the screen is written; what takes longer is added.
        with show_progress("writing", 1.0) as advance:
            advance(0.0, "drawing the report" if args.report else "")
            write(args.report, found.render_report() if args.report else None)
        write(args.prediction, found.findings.shrinkage.text)  # where it could not be, at first
    if car is not None:
        report_refusal(car)
    return ExitCode.OK


def _named_outputs(args: argparse.Namespace) -> dict[str, Path | None]:
    """What is to be written, by option."""
    named = args.json if args.json != "-" else None
    if named is not None and named.endswith(".mcap"):
        what = f"--json {named}: that is a session"
        raise SteerdError(what, "put --json last, or --json gap.json", ExitCode.USAGE)
    return {
        "--json": Path(named) if named else None,
        "--report": args.report,
        "-o": args.output,
        "--prediction": args.prediction,
    }
