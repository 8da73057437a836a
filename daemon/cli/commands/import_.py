"""`steerd import`: sessions from the logs of other systems."""

import re
import shlex
import sys
from argparse import ArgumentParser, Namespace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import missing_file, option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.packaged import EXAMPLE_MAP
from steerd.daemon.common.progress import show_progress
from steerd.daemon.common.screen import print_labelled

if TYPE_CHECKING:
    from steerd.daemon.imports.import_session import ImportReport

_KINDS = ("csv", "bag")
_BAG_SUFFIXES = (".bag", ".db3", ".mcap", ".zstd")


def import_log_arguments(parser: ArgumentParser) -> None:
    text = "the log: a table with a row per time, a ROS 1 .bag, a ROS 2 folder, or its file"
    option(parser, "words", "[csv|bag] FILE", text, nargs="+")
    option(parser, "-o --output", "SESSION.mcap", "default: beside the log", type=Path)
    option(parser, "--ask", "", "propose a map, show what it means, then write")
    text = f"which column or topic is what (TOML; {EXAMPLE_MAP} is one)"
    option(parser, "--map", None, text, missing_file, type=Path)
    text = "of 1 m/s; negative for a motor that is wired so (default: F1TENTH's 4614)"
    option(parser, "--erpm-gain", "ERPM", text, type=float)
    bag = parser.add_argument_group("bags")
    text = "which topic to take where several fit; roles: pose, command, vesc, wheel"
    option(bag, "--topic", "[ROLE=]TOPIC", text, action="append")
    option(bag, "--rigid", "ID", "which PhaseSpace body is the car", type=int)


def import_log(args: Namespace) -> None:
    """Turn another system's log into a session: a csv file or a ROS 1 or ROS 2 bag.

    steerd import RUN.bag                    # F1TENTH's topics are known by name
    steerd import --ask RUN.csv              # proposes a map and what it means
    steerd import csv RUN.csv --map MAP.toml -o RUN.mcap
    steerd import bag RUN.bag --topic /vrpn/car/pose -o RUN.mcap
    """
    kind, source = read_words(args.words)
    out = args.output or default_output(source)
    the_map = _agree(args, kind, source, out) if args.ask else args.map
    if kind == "csv" and the_map is None:
        hint = f"`steerd import --ask {source}` proposes one; {EXAMPLE_MAP} is one"
        raise UsageError("a csv file needs a map of its columns, --map", hint)
    _print_result(_import(args, kind, source, the_map, out), args, the_map)


def read_words(words: list[str]) -> tuple[str, Path]:
    """The kind of log, and the log. Raises SteerdError: there is no log, or more than one."""
    kind, rest = (words[0], words[1:]) if words[0] in _KINDS and len(words) > 1 else ("", words)
    if len(rest) != 1 or (rest[0] in _KINDS and not Path(rest[0]).exists()):
        what = f"`steerd import` takes one log, not {len(rest) if len(rest) > 1 else 'none'}"
        raise UsageError(what, "import the others one by one")
    source = Path(rest[0])
    if not source.exists():
        raise SteerdError(f"{source} does not exist", "", ExitCode.UNREADABLE)
    is_bag = source.is_dir() or source.suffix.lower() in _BAG_SUFFIXES
    return kind or ("bag" if is_bag else "csv"), source


def default_output(source: Path) -> Path:
    """A session beside the log."""
    name = source.with_suffix(".mcap")
    return name if name != source and not source.is_dir() else source.with_suffix(".session.mcap")


def _import(
    args: Namespace, kind: str, source: Path, the_map: Path | None, out: Path
) -> "ImportReport":
    if kind == "csv":
        from steerd.daemon.imports.csv_log import import_csv

        size = source.stat().st_size if source.is_file() else 1
        with show_progress(f"reading {source.name}", size, even=True) as advance:
            return import_csv(source, the_map or Path(), out, advance, args.erpm_gain)
    from steerd.daemon.imports.bag import import_bag

    with show_progress(f"reading {source.name}", 1.0, even=True) as advance:
        return import_bag(source, the_map, out, advance, args.topic, args.rigid, args.erpm_gain)


def _agree(args: Namespace, kind: str, source: Path, out: Path) -> Path:
    """The map that somebody agreed to, written beside the session."""
    from steerd.daemon.cli.import_ask import ask
    from steerd.daemon.common.written import write_outputs
    from steerd.daemon.imports.import_session import check_output

    check_output(out)
    text = ask(_propose(kind, source), source, partial(_import, args, kind, source))
    the_map = out.with_suffix(".map.toml")
    write_outputs({the_map: text})
    print(f"written: {the_map}")
    return the_map


def _propose(kind: str, source: Path) -> dict[str, dict[str, object]]:
    if kind == "csv":
        from steerd.daemon.common.translate import reading
        from steerd.daemon.imports.propose import propose_csv

        with reading(source):
            return propose_csv(source)
    from steerd.daemon.imports.bag import propose_bag

    return propose_bag(source)


def _print_result(made: "ImportReport", args: Namespace, the_map: Path | None) -> None:
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.text import format_report, print_warnings

    report = make_session_report(load_recording(made.path))
    print(format_report(report))
    for remark in made.remarks:
        print_labelled("note: ", remark, sys.stderr)
    print_warnings((*made.notes, *report.warnings))
    print(f"\nwritten: {made.path}")
    session = made.path
    if found := re.search(r"--erpm-gain (-?\d+)", " ".join(report.warnings)):
        session = made.path.with_name(f"{made.path.stem}-erpm.mcap")
        print(f"  again: {_again(args, the_map, found[1], session)}")
    print(f"   next: steerd {'identify' if made.is_drive else 'plot'} {session}")


def _again(args: Namespace, the_map: Path | None, erpm_gain: str, out: Path) -> str:
    """The same import with the ERPM per m/s that the drive shows."""
    options = ["--map", str(the_map)] if the_map else []
    options += [word for topic in args.topic for word in ("--topic", topic)]
    options += [] if args.rigid is None else ["--rigid", str(args.rigid)]
    last = ["--erpm-gain", erpm_gain, "-o", str(out)]
    return shlex.join(["steerd", "import", *args.words, *options, *last])
