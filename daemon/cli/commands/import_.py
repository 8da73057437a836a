"""`steerd import`: sessions from the logs of other systems, and the conversation of `--ask`."""

import re
import shlex
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from steerd.daemon.cli.arguments import missing_file, option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, refusing
from steerd.daemon.common.packaged import EXAMPLE_MAP
from steerd.daemon.common.screen import print_labelled, print_warnings, show_progress, wrap
from steerd.daemon.imports.import_map import ImportMap, VescSpec, load_map, parse_map

if TYPE_CHECKING:
    from steerd.daemon.imports.import_session import ImportReport
    from steerd.daemon.imports.propose import Proposal
    from steerd.daemon.sessions.info import SessionReport
    from steerd.daemon.sessions.motion import Track

Trial = Callable[[ImportMap, Path], object]  # imports by a map into a session file
_KINDS = ("csv", "bag")
_BAG_SUFFIXES = (".bag", ".db3", ".mcap", ".zstd")
_LEFT, _MM = "must be left positive", "millimetres"


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
    kind, source = _read_words(args.words)
    out: Path = args.output or source.with_suffix(".mcap")
    if args.output is None and (out == source or source.is_dir()):
        out = source.with_suffix(".session.mcap")
    the_map = _agree(args, kind, source, out) if args.ask else args.map
    if kind == "csv" and the_map is None:
        hint = f"`steerd import --ask {source}` proposes one; {EXAMPLE_MAP} is one"
        raise UsageError("a csv file needs a map of its columns, --map", hint)
    read = load_map(the_map) if the_map else ImportMap()
    _print_result(_import(args, kind, source, read, out), args, the_map)


def _read_words(words: list[str]) -> tuple[str, Path]:
    """The kind of log, and the log; a SteerdError where there is none, or more than one."""
    kind, rest = (words[0], words[1:]) if words[0] in _KINDS and len(words) > 1 else ("", words)
    if len(rest) != 1 or (rest[0] in _KINDS and not Path(rest[0]).exists()):
        what = f"`steerd import` takes one log, not {len(rest) if len(rest) > 1 else 'none'}"
        raise UsageError(what, "import the others one by one")
    source = Path(rest[0])
    if not source.exists():
        raise SteerdError(f"{source} does not exist", "", ExitCode.UNREADABLE)
    is_bag = source.is_dir() or source.suffix.lower() in _BAG_SUFFIXES
    return kind or ("bag" if is_bag else "csv"), source


def _import(
    args: Namespace, kind: str, source: Path, the_map: ImportMap, out: Path
) -> "ImportReport":
    if args.rigid is not None:
        the_map = replace(the_map, rigid=args.rigid)
    if args.erpm_gain is not None:
        with refusing(f"--erpm-gain {args.erpm_gain:g}: "):
            vesc = structs.replace(the_map.vesc or VescSpec(), erpm_gain=args.erpm_gain)
        the_map = replace(the_map, vesc=vesc)
    size = source.stat().st_size if kind == "csv" and source.is_file() else 1.0
    with show_progress(f"reading {source.name}", size, even=True) as advance:
        if kind == "csv":
            from steerd.daemon.imports.csv_log import import_csv

            return import_csv(source, the_map, out, advance)
        from steerd.daemon.imports.bag import import_bag

        return import_bag(source, the_map, out, advance, args.topic)


def _print_result(made: "ImportReport", args: Namespace, the_map: Path | None) -> None:
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.text import format_report

    report = make_session_report(load_recording(made.path))
    print(format_report(report))
    for remark in made.remarks:
        print_labelled("note: ", remark, sys.stderr)
    print_warnings((*made.notes, *report.warnings))
    print(f"\nwritten: {made.path}")
    session = made.path
    if found := re.search(r"--erpm-gain (-?\d+)", " ".join(report.warnings)):
        session = made.path.with_name(f"{made.path.stem}-erpm.mcap")
        again = ["--map", str(the_map)] if the_map else []  # the same with the drive's own gain
        again += [word for topic in args.topic for word in ("--topic", topic)]
        again += [] if args.rigid is None else ["--rigid", str(args.rigid)]
        again += ["--erpm-gain", found[1], "-o", str(session)]
        print(f"  again: {shlex.join(['steerd', 'import', *args.words, *again])}")
    print(f"   next: steerd {'identify' if made.is_drive else 'plot'} {session}")


# -- --ask: a proposed map, what it would mean, changes, yes ---------------------------------------


def _agree(args: Namespace, kind: str, source: Path, out: Path) -> Path:
    """The map that somebody agreed to, written beside the session."""
    from steerd.daemon.common.errors import reading
    from steerd.daemon.common.written import write_outputs
    from steerd.daemon.imports.import_session import check_output

    check_output(out)
    if kind == "csv":
        from steerd.daemon.imports.propose import propose_csv

        with reading(source):
            proposal = propose_csv(source)
    else:
        from steerd.daemon.imports.bag import propose_bag

        proposal = propose_bag(source)
    the_map = out.with_suffix(".map.toml")
    write_outputs({the_map: _ask(proposal, source, partial(_import, args, kind, source))})
    print(f"written: {the_map}")
    return the_map


def _ask(proposal: "Proposal", source: Path, trial: Trial) -> str:
    """Talk about a proposal until somebody agrees: the map's text; a SteerdError if nobody does."""
    from steerd.daemon.imports.propose import change, list_sections

    text = _show(proposal, source, trial, fix=True)
    while True:
        print("Enter writes it; NAME = COLUMN [* SCALE] changes a line; ? lists names; q leaves")
        print("> ", end="", flush=True)
        line = sys.stdin.readline()
        answer = line.strip()
        if not line or answer == "q":
            raise UsageError("nothing was written")
        if answer == "?":
            print(*wrap(", ".join(list_sections(proposal)), "  ", "  "), sep="\n")
        elif answer:
            wrong = change(proposal, answer)
            if wrong:
                print(f"  {wrong}")
            else:
                text = _show(proposal, source, trial, fix=False)
        elif text:
            return text
        else:
            print("  it cannot be imported like this")


def _show(proposal: "Proposal", source: Path, trial: Trial, *, fix: bool) -> str:
    """Print the map and its meaning; the map's text, or nothing where it does not work."""
    from steerd.daemon.imports.propose import format_map

    found, problem = None, ""
    try:
        found = _try(proposal, source, trial)
        if fix and _fix(proposal, *found[1:]):
            found = _try(proposal, source, trial)
    except SteerdError as error:
        no_file = error.hint and str(EXAMPLE_MAP) not in error.hint
        found, problem = None, f"{error.what}; {error.hint}" if no_file else error.what
    text = format_map(proposal, source.name)
    print("\nproposed map")
    print(*(f"  {line}" for line in text.splitlines() if line.strip()), sep="\n")
    print("\nwhat it would mean")
    if found is None:
        print(f"  nothing yet: {problem}")
        return ""
    lines, doubts, _ = found
    print(*(f"  {line}" for line in lines), sep="\n")
    print(*(f"  doubtful: {doubt}\n" for doubt in doubts), sep="", end="")
    return text


def _try(
    proposal: "Proposal", source: Path, trial: Trial
) -> tuple[list[str], tuple[str, ...], float | None]:
    """What the map makes of the log: in words, what looks wrong, ERPM per m/s by the poses."""
    from steerd.daemon.imports.propose import format_map
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.motion import find_erpm_gain, round_gain
    from steerd.steer_bus.topics import VESC

    with refusing("the map: "):
        the_map = parse_map(format_map(proposal, source.name))
    with tempfile.TemporaryDirectory(prefix="steerd-") as folder:
        trial(the_map, out := Path(folder) / "trial.mcap")
        read = load_recording(out)
        report, track = make_session_report(read), read.track
        gain = find_erpm_gain(track, read.signal(VESC, "erpm"))
    gain = None if gain is None else round_gain(gain)
    return [*_lines(report, track, gain)], report.warnings, gain


def _lines(report: "SessionReport", track: "Track | None", gain: float | None) -> Iterator[str]:
    import numpy as np

    yield f"{report.info.duration_s:.1f} s, {report.info.count} messages"
    if report.length_m is not None:
        yield f"driven    {report.length_m:.1f} m"
    if report.speed:
        yield f"speed     {report.speed.low:.2f} to {report.speed.high:.2f} m/s"
    if track is not None:
        turn = np.diff(np.unwrap(track.yaw))
        left, right = degrees(turn.clip(0.0).sum()), degrees((-turn).clip(0.0).sum())
        yield f"turned    {left:.0f}° to the left, {right:.0f}° to the right"
    if report.steer:
        low, high = report.steer.low, report.steer.high
        yield f"steering  {degrees(low):+.1f} to {degrees(high):+.1f}°, left is positive"
    if gain is not None:
        yield f"motor     {gain:.0f} ERPM per m/s, by the poses"


def _fix(proposal: "Proposal", doubts: Sequence[str], erpm_gain: float | None) -> bool:
    """Change what the drive itself says must be otherwise; whether anything was."""
    from steerd.daemon.imports.propose import scaled

    text, fixed = " ".join(doubts), False
    columns = proposal.get("columns", {})
    if _LEFT in text and "steer_cmd" in columns:
        old = columns["steer_cmd"]
        name, scale = (old, 1.0) if isinstance(old, str) else (old["column"], old["scale"])
        columns["steer_cmd"], fixed = scaled(name, -scale), True
    if "topics" in proposal and _MM in text:
        proposal.setdefault("frame", {})["units"], fixed = "mm", True
    if erpm_gain is not None and "--erpm-gain" in text:
        proposal.setdefault("vesc", {})["erpm_gain"], fixed = erpm_gain, True
    return fixed
