"""Parameters learnt during a drive, as they came, and when the car changed.

The learner of `steerd run --learn` on a recorded drive. It learns the car in
the first 25 s of driving, follows it, and says when it changed, and how.

steerd learn RUN.mcap
steerd learn RUN.mcap --base car.toml --json
"""

import argparse
import sys
from pathlib import Path

from steerd.daemon.cli.arguments import add_session, missing_car, option, pick_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session(parser)
    base = "the car as believed (default: the session's)"
    option(parser, "--base", "FILE.toml", base, missing_car, type=Path)
    option(parser, "--json", "", "the same for programs")


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.analysis.learning import learn_session
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.screen import print_labelled, wrap
    from steerd.daemon.learning.text import encode_model, format_model

    path = pick_session(args.session)
    with show_progress("learning", 1.0) as advance:
        found = learn_session(path, args.base, share=advance)
    if found.remark:
        print_labelled("note: ", found.remark, sys.stderr)
    if args.json:
        import json

        reports = {"count": found.reports, "sha256": found.digest}
        values = {"schema": "steerd.learn/1", **encode_model(found.report), "reports": reports}
        print(json.dumps(values, indent=1, allow_nan=False))
        return
    about = f"{path.name}: {found.report.windows} half seconds of driving, about {found.base}"
    print(*wrap(about, "", "  "), *format_model(found.report), sep="\n")
    if found.recorded:
        print(f"reports in the session: {found.same} of {found.recorded} the same to the byte")
    print(f"{found.reports} reports, sha256 {found.digest[:16]}")
