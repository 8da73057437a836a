"""Turn another system's log into a session: a csv file or a ROS 1 or ROS 2 bag.

steerd import csv RUN.csv --map MAP.toml -o RUN.mcap
steerd import bag RUN.bag --topic /vrpn/car/pose -o RUN.mcap
"""

import argparse
import sys
from pathlib import Path

from steerd.daemon.common.errors import ExitCode
from steerd.daemon.common.packaged import EXAMPLE_MAP


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The two kinds of log and their options."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="csv|bag")
    table = kinds.add_parser("csv", help="a table with one row per time")
    bag = kinds.add_parser("bag", help="a ROS 1 .bag, a ROS 2 bag folder or its .mcap file")
    for kind in (table, bag):
        kind.add_argument("source", type=Path, metavar="FILE", help="the log")
        kind.add_argument("-o", "--output", type=Path, required=True, metavar="SESSION.mcap")
    table.add_argument(
        "--map", type=Path, required=True, help=f"which column is what (TOML; {EXAMPLE_MAP} is one)"
    )
    bag.add_argument("--map", type=Path, help="topics, frame and car name (TOML)")
    bag.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="[ROLE=]TOPIC",
        help="which topic to take where several fit; roles: pose, command, vesc, wheel",
    )
    bag.add_argument("--rigid", type=int, metavar="ID", help="which PhaseSpace body is the car")


def run(args: argparse.Namespace) -> int:
    """Import, then print what the session holds.

    Raises:
        SteerdError: the log, its map or the output cannot be used.
    """
    from steerd.daemon.common.progress import show_progress

    if args.kind == "csv":
        from steerd.daemon.imports.csv_log import import_csv

        size = args.source.stat().st_size if args.source.is_file() else 1
        with show_progress(f"reading {args.source.name}", size) as advance:
            report = import_csv(args.source, args.map, args.output, advance)
    else:
        from steerd.daemon.imports.bag import BagChoice, import_bag

        choice = BagChoice(tuple(args.topic), args.rigid)
        with show_progress(f"reading {args.source.name}", 1.0) as advance:
            report = import_bag(args.source, args.map, args.output, choice, advance)
    _print_result(report.path, report.notes)
    return ExitCode.OK


def _print_result(path: Path, notes: tuple[str, ...]) -> None:
    from steerd.daemon.common.screen import print_labelled
    from steerd.daemon.sessions.info import load_session, make_session_report
    from steerd.daemon.sessions.text import format_report

    report = make_session_report(load_session(path))
    print(format_report(report))
    for note in (*notes, *report.warnings):
        print_labelled("warning: ", note, sys.stderr)
    print(f"\nwritten: {path}\n   next: steerd identify {path}")
