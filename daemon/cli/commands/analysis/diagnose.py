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
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.car_written import report_refusal
from steerd.daemon.cli.inputs import reads_car, reads_session
from steerd.daemon.cli.session_argument import add_sessions, pick_sessions
from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.daemon.analysis.diagnose_case import DiagnoseRequest


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
        "--healthy", action="append", default=[], metavar="FILE,…",
        help="drives of the same car without the gap: they determine how large noise is",
    ))  # fmt: skip
    what.add_argument(
        "--only", action="append", default=[], metavar="EFFECT", help="look at this one (repeat)"
    )
    what.add_argument(
        "--without", action="append", default=[], metavar="EFFECT", help="leave it out (repeat)"
    )
    what.add_argument("--no-pairs", action="store_true", help="one cause at most; faster")
    what.add_argument(
        "--speed",
        choices=("command", "wheel"),
        default="command",
        help="wheel: the speed command was not obeyed, take the measured speed instead",
    )
    reads_session(what.add_argument(
        "--held-out", action="append", default=[], metavar="K|FILE,…",
        help="measure the shrinkage on every K-th drive (default 4; 0: none), or on these files",
    ))  # fmt: skip
    what.add_argument(
        "--runs-held-out", dest="held_out", action="append", help=argparse.SUPPRESS
    )  # until 0.1
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
        "--no-closed-loop", action="store_true", help="do not drive the session's lane again"
    )
    where = parser.add_argument_group("where")
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="candidates side by side")
    where.add_argument(
        "--dask", metavar="ADDRESS", help="gone: `steerd batch` shares whole sessions"
    )


def make_request(args: argparse.Namespace) -> "DiagnoseRequest":
    """Typed values of the command line.

    Raises:
        SteerdError: what is held out makes no sense, or an option is gone.
    """
    if args.dask is not None:
        what = "--dask: the candidates of one diagnosis share nothing worth sending"
        hint = "steerd batch diagnose SESSIONS --dask ADDRESS shares whole sessions"
        raise SteerdError(what, hint, ExitCode.USAGE)
    from steerd.daemon.analysis.diagnose_case import DiagnoseRequest
    from steerd.daemon.analysis.held_out import parse_held_out, split_list

    return DiagnoseRequest(
        sessions=tuple(pick_sessions(args.sessions)),
        base=args.base,
        held_out=parse_held_out(args.held_out),
        healthy=tuple(map(Path, split_list(args.healthy))),
        only=tuple(args.only),
        without=tuple(args.without),
        pairs=not args.no_pairs,
        closed_loop=not args.no_closed_loop,
        speed=args.speed,
        jobs=args.jobs,
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose, print, write.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    from steerd.daemon.analysis.diagnose_text import describe
    from steerd.daemon.analysis.diagnosis import DRIVEN, run_diagnosis
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import write_outputs
    from steerd.daemon.sessions.text import print_warnings

    _check_outputs(args)
    request = make_request(args)
    late: list[str] = []
    with show_progress("diagnosing", 1.0) as advance:
        found = run_diagnosis(
            request, print_warnings, advance, lambda text: _announce(text, args.prediction, late)
        )
        advance(DRIVEN, "")
        data = found.to_json()
    if args.json == "-":
        print(json.dumps(data, indent=1), flush=True)
    else:
        print(describe(found, args.output, args.report), flush=True)
    # What follows may fail, for want of space for instance; the result is on the screen by then.
    with show_progress("writing", 1.0) as advance:
        advance(0.0, "drawing the report" if args.report else "")
        report = found.render_report() if args.report else None
    named = Path(args.json) if args.json and args.json != "-" else None
    car = found.make_car(args.output).text if args.output else None
    text = json.dumps(data, indent=1) + "\n"
    foretold = late[0] if late else None
    texts = {args.prediction: foretold, named: text, args.report: report, args.output: car}
    write_outputs(texts, announced=True)
    if car is not None:
        report_refusal(args.output)
    return ExitCode.OK


def _check_outputs(args: argparse.Namespace) -> None:
    """What cannot be written is reported before the work, not after it."""
    from steerd.daemon.common.outputs import check_outputs

    named = args.json if args.json != "-" else None
    if named is not None and named.endswith(".mcap"):
        what = f"--json {named}: that is a session"
        raise SteerdError(what, "put --json last, or --json gap.json", ExitCode.USAGE)
    check_outputs(
        {
            "--json": Path(named) if named else None,
            "--report": args.report,
            "-o": args.output,
            "--prediction": args.prediction,
        }
    )


def _announce(prediction: str, path: Path | None, late: list[str]) -> None:
    """The prediction's digest, and the prediction itself, before anything is measured.

    Where it cannot be written, the diagnosis goes on: the digest is on the screen, so the same
    text, kept in `late`, may be written after it.
    """
    import hashlib

    from steerd.daemon.common.written import write_outputs

    digest = hashlib.sha256(prediction.encode()).hexdigest()
    print(f"predicted before measuring: sha256 {digest}", file=sys.stderr)
    try:
        write_outputs({path: prediction})
    except SteerdError:
        late.append(prediction)
