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
import sys
from pathlib import Path
from typing import Any

from steerd.daemon.cli import arguments
from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    arguments.add_sessions(parser)
    what = parser.add_argument_group("what is compared")
    text = "the car as identified (default: the car file inside the session)"
    option(what, "--base", "CAR.toml", text, arguments.missing_car, type=Path)
    option(what, "--car", None, argparse.SUPPRESS, dest="base", type=Path)
    text = "drives of the same car without the gap: they determine how large noise is"
    more: dict[str, Any] = {"type": arguments.split_paths, "action": "extend", "default": []}
    option(what, "--healthy", "FILE,…", text, arguments.missing_session, **more)
    option(what, "--only", "EFFECT", "look at this one (repeat)", action="append")
    option(what, "--without", "EFFECT", "leave it out (repeat)", action="append")
    option(what, "--no-pairs", "", "one cause at most; faster", dest="pairs", action="store_false")
    text = "wheel: the speed command was not obeyed, take the measured speed instead"
    option(what, "--speed", None, text, choices=("command", "wheel"), default="command")
    more = {"type": arguments.split_held_out, "action": "extend"}
    text = "measure the shrinkage on every K-th drive (default 4; 0: none), or on these files"
    option(what, "--held-out", "K|FILE,…", text, arguments.missing_session, **more)
    option(what, "--runs-held-out", None, argparse.SUPPRESS, dest="held_out", **more)  # until 0.1
    out = parser.add_argument_group("output")
    more = {"nargs": "?", "const": Path("-"), "type": Path}
    option(out, "--json", "FILE", "for programs; alone: to the terminal", **more)
    option(out, "--report", "FILE.html", "one page, plots first", type=Path)
    option(out, "-o --output", "CAR.toml", "the base with the found effect", type=Path)
    option(out, "--prediction", "FILE", "the prediction, before it is measured", type=Path)
    text = "do not drive the session's lane again"
    option(out, "--no-closed-loop", "", text, dest="closed_loop", action="store_false")
    where = parser.add_argument_group("where")
    option(where, "--jobs", "N", "candidates side by side", type=int, default=1)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.analysis.diagnosis import DRIVEN, DiagnoseOptions, run_diagnosis
    from steerd.daemon.analysis.options import read_arguments
    from steerd.daemon.assembly.build import report_refusal
    from steerd.daemon.cli.results import list_outputs, present
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import writing
    from steerd.daemon.sessions.text import print_warnings

    if args.json is not None and args.json.suffix == ".mcap":
        what = f"--json {args.json}: that is a session"
        raise SteerdError(what, "put --json last, or --json gap.json", ExitCode.USAGE)
    named = {**list_outputs(args), "--prediction": args.prediction}
    with writing(named, announced=True) as write:

        def foretell(text: str) -> None:
            """The prediction's digest, and the prediction itself, before anything is measured."""
            digest = hashlib.sha256(text.encode()).hexdigest()
            print(f"predicted before measuring: sha256 {digest[:16]}…", file=sys.stderr)
            write(args.prediction, text)

        options = read_arguments(DiagnoseOptions, args)
        paths = arguments.pick_sessions(args.sessions)
        with show_progress("diagnosing", 1.0) as advance:
            found = run_diagnosis(paths, options, print_warnings, advance, foretell)
            advance(DRIVEN, "")
        car = present(found, args, write)
        write(args.prediction, found.findings.shrinkage.text)  # where it could not be, at first
    if car is not None:
        report_refusal(car)
