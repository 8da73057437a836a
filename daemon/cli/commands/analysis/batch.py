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

from steerd.daemon.cli.arguments import missing_file, option

_KINDS = ("summarise", "identify", "diagnose")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "kind", None, "what is asked of each session", choices=_KINDS)
    option(parser, "sessions", "DIR|PATTERN", "folders, patterns in quotes, or files", nargs="+")
    text = "car files: NAME.toml for the car NAME, or one for all"
    option(parser, "--cars", "DIR|CAR.toml", text, missing_file, type=Path)
    out = parser.add_argument_group("output")
    option(out, "-o --output", "FILE.parquet", "a row for each session", type=Path)
    option(out, "--page", "FILE.html", "one page with figures", type=Path)
    where = parser.add_argument_group("where")
    option(where, "--jobs", "N", "processes (default: one per core)", type=int, default=0)
    option(where, "--dask", "ADDRESS", "a Dask scheduler instead")


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.common.written import check_outputs

    check_outputs({"-o": args.output, "--page": args.page})
    from steerd.daemon.many.batch.run import make_job
    from steerd.daemon.many.batch.unit import Question, find_batch, read_cars
    from steerd.daemon.many.job import do_in_terminal
    from steerd.daemon.many.units import Where

    job = make_job(find_batch(args.sessions), Question(args.kind, read_cars(args.cars)))
    do_in_terminal(job, Where(args.jobs, args.dask), args.output, args.page)
