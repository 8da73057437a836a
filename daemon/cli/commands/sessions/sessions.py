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

import argparse
import sys
from pathlib import Path

from steerd.daemon.cli.arguments import missing_session, option
from steerd.daemon.common.errors import ExitCode, SteerdError

SHOWN = 40  # drives that are listed unless all are asked for


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.sessions.catalogue import default_folders, find_session

    if args.folder is not None and not args.folder.is_dir():
        raise SteerdError(f"there is no folder {args.folder}", "", ExitCode.UNREADABLE)
    folders = (args.folder,) if args.folder else default_folders()
    if args.kind is None:
        _list(args, folders)
    else:
        _write(args, find_session(args.session, folders))


def _list(args: argparse.Namespace, folders: tuple[Path, ...]) -> None:
    from steerd.daemon.common.progress import show_progress
    from steerd.daemon.common.written import check_outputs, write_outputs
    from steerd.daemon.sessions import catalogue

    page = folders[0] / "sessions.html" if args.page == Path() else args.page
    if page:
        check_outputs({"--page": page})
    paths = catalogue.find_sessions(folders)
    shown = paths if args.all or args.tag or args.car or args.json or page else paths[:SHOWN]
    with show_progress("reading the drives", float(len(shown)), even=True) as advance:
        entries = list(catalogue.list_entries(shown, advance))
    places = {path: number for number, path in enumerate(paths, 1)}
    entries = [
        e
        for e in entries
        if (not args.tag or args.tag in e.tags) and (not args.car or args.car == e.car)
    ]
    if args.json:
        import json

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


def _write(args: argparse.Namespace, session: Path) -> None:
    from steerd.daemon.sessions.catalogue import notes_file, read_notes, write_notes

    tags, note = read_notes(session)
    match args.kind:
        case "tag":
            tags = (*tags, *args.tags)
        case "untag":
            tags = tuple(tag for tag in tags if tag not in args.tags)
        case _:
            note = " ".join(args.text)
    write_notes(session, tags, note)
    print(f"written: {notes_file(session)}")
