"""Commands on recorded drives: the list of them, and what is done with one."""

import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from steerd.daemon.cli import arguments
from steerd.daemon.cli.arguments import missing_partial, missing_session, option, pick_session
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, reading
from steerd.daemon.common.screen import print_warnings, show_progress
from steerd.daemon.common.written import check_outputs, write_outputs

SHOWN = 40  # drives that are listed unless all are asked for
_FIGURES = (".png", ".svg", ".pdf")


def sessions_arguments(parser: ArgumentParser) -> None:
    option(parser, "--folder", "DIR", "another folder than these", type=Path)
    option(parser, "--tag", "TAG", "only drives with this tag")
    option(parser, "--car", "NAME", "only drives of this car")
    option(parser, "--all", "", f"more than {SHOWN}")
    option(parser, "--json", "", "the same for programs")
    text = "the same as a page (default: sessions.html in the folder)"
    option(parser, "--page", "FILE.html", text, nargs="?", type=Path, const=Path())
    kinds = parser.add_subparsers(dest="kind", metavar="tag|untag|note")
    for kind, text in (("tag", "add tags to a drive"), ("untag", "take tags away")):
        child = kinds.add_parser(kind, help=text)
        option(child, "session", "SESSION", "a file, @last or @-N", missing_session)
        option(child, "tags", "TAG", "", nargs="+")
    note = kinds.add_parser("note", help="write a sentence about a drive; an empty one removes it")
    option(note, "session", "SESSION", "a file, @last or @-N", missing_session)
    option(note, "text", "TEXT", "", nargs="+")


def sessions(args: Namespace) -> None:
    """The recorded drives: when, which car, what was driven, how well, and notes.

    steerd sessions                          # this folder's, and those kept by run
    steerd sessions --folder DIR --tag wet
    steerd sessions --page                   # as an HTML page: sessions.html
    steerd sessions tag @last wet new-tyres  # untag takes them away
    steerd sessions note @-2 "left front tyre changed"

    @last is the drive that ended last, @-2 the one before it; plot, info, replay,
    identify and diagnose take them too. Tags and notes lie beside the session, in
    NAME.notes.toml.
    """
    from steerd.daemon.sessions import catalogue

    if args.folder is not None and not args.folder.is_dir():
        raise SteerdError(f"there is no folder {args.folder}", "", ExitCode.UNREADABLE)
    folders = (args.folder,) if args.folder else catalogue.default_folders()
    if args.kind is None:
        _list(args, folders)
        return
    session = catalogue.find_session(args.session, folders)
    tags, note = catalogue.read_notes(session)
    if args.kind == "tag":
        tags = (*tags, *args.tags)
    elif args.kind == "untag":
        tags = tuple(tag for tag in tags if tag not in args.tags)
    else:
        note = " ".join(args.text)
    catalogue.write_notes(session, tags, note)
    print(f"written: {catalogue.notes_file(session)}")


def _list(args: Namespace, folders: tuple[Path, ...]) -> None:
    from steerd.daemon.sessions import catalogue

    page = folders[0] / "sessions.html" if args.page == Path() else args.page
    if page:
        check_outputs({"--page": page})
    paths = catalogue.find_sessions(folders)
    shown = paths if args.all or args.tag or args.car or args.json or page else paths[:SHOWN]
    with show_progress("reading the drives", float(len(shown)), even=True) as advance:
        entries = list(catalogue.list_entries(shown, advance))
    places = {path: number for number, path in enumerate(paths, 1)}
    entries = [e for e in entries if not args.tag or args.tag in e.tags]
    entries = [e for e in entries if not args.car or args.car == e.car]
    if args.json:
        print(json.dumps(catalogue.make_json(entries), indent=1, allow_nan=False))
        return
    if page:
        from steerd.sysid.report.page import render_report

        write_outputs({page: render_report(catalogue.make_report(entries, page.parent))})
        print(f"{page}: {len(entries)} drives; open it in a browser")
        return
    if not entries:
        print(f"no drive in {' or '.join(str(folder) for folder in folders)}", file=sys.stderr)
        return
    print("\n".join(catalogue.format_entries(entries, [places[e.path] for e in entries])))
    if len(paths) > len(shown):
        print(f"and {len(paths) - len(shown)} older ones: --all")


def info_arguments(parser: ArgumentParser) -> None:
    arguments.add_session(parser)
    option(parser, "--json", "", "the same for programs")


def info(args: Namespace) -> None:
    """Contents of a session: car, time, states, motion, topics, and how it ended.

    steerd info SESSION.mcap
    steerd info SESSION.mcap --json
    """
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.text import format_report, make_json

    report = make_session_report(load_recording(pick_session(args.session)))
    if args.json:
        print(json.dumps(make_json(report), indent=1, allow_nan=False))
        return
    print(format_report(report))
    print_warnings(report.warnings)


def plot_arguments(parser: ArgumentParser) -> None:
    arguments.add_sessions(parser)
    option(parser, "-o --output", "FILE.html", "default: beside the session", type=Path)
    text = "of two drives: the second comes so much later (default: found from the drives)"
    option(parser, "--shift", "SECONDS", text, type=float)


def plot(args: Namespace) -> None:
    """A drive as one HTML page: track, errors, commands and measurements, timing.

    The page needs no network: send it by mail, or keep it beside the session.

    steerd plot SESSION.mcap -o DRIVE.html
    steerd plot SESSION.mcap -o DRIVE.svg    # the main curves; .png and .pdf too
    steerd plot SESSION.mcap -o DRIVE.csv    # all curves and the track, every 10 ms
    steerd plot BEFORE.mcap AFTER.mcap       # by place on the lane, and over time
    """
    paths = [*map(pick_session, args.sessions)]
    if args.shift is not None and len(paths) != 2:
        raise UsageError("--shift is for two drives", "name two")
    name = "-".join(path.stem for path in paths)[:120]
    output = args.output or paths[0].with_name(f"{name}.html")
    check_outputs({"-o": output})
    other = output.suffix.lower() in (*_FIGURES, ".csv")
    if other and len(paths) > 1:
        raise UsageError(f"{output.name}: several drives are compared on a page", "-o FILE.html")
    if len(paths) > 1:
        from steerd.daemon.sessions.compare import render_comparison
        from steerd.daemon.sessions.info import load_recording

        content = render_comparison(list(map(load_recording, paths)), args.shift).encode()
    else:
        content = _draw(paths[0], output.suffix.lower())
    write_outputs({output: content})
    print(f"{output}: {len(content) / 1e6:.1f} MB{'' if other else '; open it in a browser'}")


def _draw(path: Path, suffix: str) -> bytes:
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.plot_data import make_drawing
    from steerd.daemon.sessions.plot_page import make_csv, make_page

    read = load_recording(path)
    report = make_session_report(read)
    print_warnings(report.warnings)
    drawing = make_drawing(read)
    if suffix in _FIGURES:
        from steerd.daemon.analysis.figures import plot_session, save_figure

        return save_figure(plot_session(drawing, path.name), suffix[1:])
    text = make_csv(drawing) if suffix == ".csv" else make_page(report, drawing)
    return text.encode()


def replay_arguments(parser: ArgumentParser) -> None:
    arguments.add_session(parser)
    option(parser, "--show", "N", "differences to print", type=int, default=5)


def replay(args: Namespace) -> int:
    """Feed a recorded session through the loop and report commands that differ."""
    from steerd.daemon.offline.replay import describe_difference, replay
    from steerd.daemon.sessions.info import load_session

    path = pick_session(args.session)
    session = load_session(path)
    print_warnings(session.info().warnings)
    count = first_ns = 0
    with show_progress("replaying", float(session.info().count), even=True) as advance:
        going, differences = replay(session, path.name, lambda done: advance(float(done)))
        for difference in differences:
            first_ns = first_ns or difference.t_ns
            count += 1
            if count <= args.show:
                print(describe_difference(difference, first_ns))
    if not going.ticks:
        raise SteerdError("the session holds no ticks: there is nothing to replay")
    verdict = f"{count} of them differ" if count else "all equal the recorded ones"
    print(f"{going.ticks} commands replayed: {verdict}")
    return ExitCode.DIFFERS if count else ExitCode.OK


def recover_arguments(parser: ArgumentParser) -> None:
    option(parser, "session", "SESSION", "an unfinished session file", missing_partial, type=Path)
    option(parser, "-o --output", "OUT.mcap", "default: NAME.recovered.mcap", type=Path)


def recover(args: Namespace) -> None:
    """Rebuild the session of a killed recorder: all that can be read, in a new file.

    steerd recover SESSION.mcap

    Reads SESSION.mcap.partial where the session never got its name.
    """
    from steerd.daemon.imports.import_session import check_output
    from steerd.daemon.sessions.info import load_session
    from steerd.steer_bus.session import recover

    partial = args.session.with_name(args.session.name + ".partial")
    source: Path = partial if partial.exists() and not args.session.exists() else args.session
    name = source.name.removesuffix(".partial").removesuffix(".mcap")
    out: Path = args.output or source.with_name(f"{name}.recovered.mcap")
    session = load_session(source)
    info = session.info()
    if info.finished and not info.warnings:
        print(f"{source} is complete: nothing to recover")
        return
    if not info.count:
        raise SteerdError(f"{source} holds no message that can be read")
    check_output(out)
    with reading(source):
        longest = recover(session, out)
    print_warnings(info.warnings)
    print(f"saved    {info.count} messages, {info.duration_s:.1f} s")
    print(f"lost     {info.lost} unreadable bytes, and data not yet on the disk")
    print(f"longest  {longest:.3g} s without any message")
    print(f"\nwritten: {out}\n   next: steerd info {out}")
