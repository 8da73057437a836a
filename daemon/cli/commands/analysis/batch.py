"""Summarise, identify or diagnose many sessions at once, each by itself.

steerd batch summarise drives/ -o drives.parquet --page drives.html
steerd batch identify 'lab/*/2026-1*.mcap' --cars cars/ -o cars.parquet
steerd batch diagnose drives/ --cars cars/ -o gap.parquet --dask tcp://host:8786

Cars are distinguished by the names in their sessions; --cars names a folder
with NAME.toml for each. The page shows each quantity over weeks, and since
which day a car is another. A session that fails is a row. The same command
works on new sessions only, also after Ctrl-C. Exit code 3: nothing is there.
"""

import argparse
from pathlib import Path

from steerd.daemon.cli.inputs import reads_file
from steerd.daemon.common.errors import ExitCode

_KINDS = ("summarise", "identify", "diagnose")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd batch`."""
    parser.add_argument("kind", choices=_KINDS, help="what is asked of each session")
    parser.add_argument(
        "sessions", nargs="+", metavar="DIR|PATTERN", help="folders, patterns in quotes, or files"
    )
    reads_file(parser.add_argument(
        "--cars", type=Path, metavar="DIR|CAR.toml",
        help="car files: NAME.toml for the car NAME, or one for all",
    ))  # fmt: skip
    out = parser.add_argument_group("output")
    out.add_argument(
        "-o", "--output", type=Path, metavar="FILE.parquet", help="a row for each session"
    )
    out.add_argument("--page", type=Path, metavar="FILE.html", help="one page with figures")
    where = parser.add_argument_group("where")
    where.add_argument(
        "--jobs", type=int, default=0, metavar="N", help="processes (default: one per core)"
    )
    where.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler instead")


def run(args: argparse.Namespace) -> int:
    """Work on the sessions, print, write.

    Raises:
        SteerdError: an argument cannot be used, or a file not be written.
    """
    from steerd.daemon.common.outputs import check_outputs
    from steerd.daemon.many.batch.sources import Question, find_batch, read_cars
    from steerd.daemon.many.journal import going_on
    from steerd.daemon.many.units import Where

    check_outputs({"-o": args.output, "--page": args.page})
    paths, where = find_batch(args.sessions), Where(args.jobs, args.dask)
    question = Question(args.kind, read_cars(args.cars))
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import write_outputs
    from steerd.daemon.many.batch.run import run_batch

    with show_progress(args.kind, float(len(paths)), even=True) as advance, going_on(args.output):
        found = run_batch(paths, question, where, args.output, lambda n: advance(float(n)))
    print(found, flush=True)
    table = found.encode_table() if args.output else None
    page = found.render_report() if args.page else None
    write_outputs({args.output: table, args.page: page}, announced=True)
    return ExitCode.OK
