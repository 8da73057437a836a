"""Commands over many drives: simulated ones, each another draw, and the sessions of a lab."""

from argparse import ArgumentParser, Namespace, _ArgumentGroup
from pathlib import Path

from steerd.daemon.cli.arguments import missing_file, option
from steerd.daemon.common.errors import UsageError
from steerd.daemon.common.packaged import EXAMPLES
from steerd.daemon.common.screen import NBSP, wrap
from steerd.daemon.common.written import check_outputs


def sweep_arguments(parser: ArgumentParser) -> None:
    option(parser, "file", "SWEEP.toml", "what to drive", missing_file, type=Path, nargs="?")
    option(parser, "--example", "", "print a sweep file and end")
    _add_outputs(parser, "drive", "work")
    again = parser.add_argument_group("one drive of it")
    option(again, "--again", "N", "drive number N alone", type=int)
    option(again, "--record", "FILE.mcap", "session file of that drive", type=Path)


def sweep(args: Namespace) -> None:
    """Drive the closed loop many times in virtual time, each time another draw.

    steerd sweep sweep.toml -o sweep.parquet --page sweep.html
    steerd sweep sweep.toml --again 17 --record worst.mcap

    The sweep file names seeds and what is varied: car parameters, effects, noise,
    paths, speeds; lists are crossed, distributions are drawn for every seed. An
    interrupted sweep goes on where it was when the same command is given again;
    the same file gives the same bytes. `steerd sweep --example` prints a sweep
    file. Exit code 3: a file cannot be read; 4: the sweep file says something
    impossible.
    """
    if args.example:
        print((EXAMPLES / "sweep.toml").read_text(encoding="utf-8"), end="")
        return
    if args.file is None:
        raise UsageError("a sweep file is needed", "steerd sweep --example > sweep.toml")
    check_outputs({"-o": args.output, "--page": args.page})
    if (args.again is None) != (args.record is None):
        raise UsageError("--again and --record go together", "name both")
    from steerd.daemon.many.job import do_in_terminal
    from steerd.daemon.many.sweep.plan import load_sweep
    from steerd.daemon.many.sweep.run import find_case, make_job, prepare
    from steerd.daemon.many.units import Where

    plan = load_sweep(args.file)
    if args.again is None:
        do_in_terminal(make_job(plan), Where(args.jobs), args.output, args.page)
        return
    from steerd.daemon.offline.fast import check_driven, record_virtual
    from steerd.daemon.offline.virtual import drive
    from steerd.sim_hw.world import World

    case = find_case(plan, args.again)
    run_plan, config = prepare(plan, case)
    drawn = ", ".join(
        f"{name}{NBSP}{value if isinstance(value, str) else format(value, '.4g')}"
        for name, value in case.values.items()
    )
    head = f"drive {case.number}: "
    print("\n".join(wrap(f"seed {case.seed}{', ' if drawn else ''}{drawn}", head, " " * 4)))
    run = record_virtual(run_plan, args.record, drive, world=World(config))
    if run.core.loop.faulted:
        print(f"stopped: {run.core.loop.fault}")
    check_driven(run)
    print(f"written: {args.record}\n   next: steerd plot {args.record}")


def batch_arguments(parser: ArgumentParser) -> None:
    kinds = ("summarise", "identify", "diagnose")
    option(parser, "kind", None, "what is asked of each session", choices=kinds)
    option(parser, "sessions", "DIR|PATTERN", "folders, patterns in quotes, or files", nargs="+")
    text = "car files: NAME.toml for the car NAME, or one for all"
    option(parser, "--cars", "DIR|CAR.toml", text, missing_file, type=Path)
    where = _add_outputs(parser, "session", "where")
    option(where, "--dask", "ADDRESS", "a Dask scheduler instead")


def _add_outputs(parser: ArgumentParser, each: str, title: str) -> _ArgumentGroup:
    out = parser.add_argument_group("output")
    option(out, "-o --output", "FILE.parquet", f"a row for each {each}", type=Path)
    option(out, "--page", "FILE.html", "one page with figures", type=Path)
    where = parser.add_argument_group(title)
    option(where, "--jobs", "N", "processes (default: one per core)", type=int, default=0)
    return where


def batch(args: Namespace) -> None:
    """Summarise, identify or diagnose many sessions at once, each by itself.

    steerd batch summarise drives/ -o drives.parquet --page drives.html
    steerd batch identify 'lab/*/2026-1*.mcap' --cars cars/ -o cars.parquet
    steerd batch diagnose drives/ --cars cars/ -o gap.parquet --dask tcp://host:8786

    Cars are distinguished by the names in their sessions; --cars names a folder
    with NAME.toml for each. The page shows each quantity over weeks, and since
    which day a car is another. A session that fails is a row. The same command
    works on new sessions only, also after Ctrl-C. Exit code 3: nothing is there.
    """
    check_outputs({"-o": args.output, "--page": args.page})
    from steerd.daemon.many.batch.run import Question, find_batch, make_job, read_cars
    from steerd.daemon.many.job import do_in_terminal
    from steerd.daemon.many.units import Where

    job = make_job(find_batch(args.sessions), Question(args.kind, read_cars(args.cars)))
    do_in_terminal(job, Where(args.jobs, args.dask), args.output, args.page)
