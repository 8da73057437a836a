"""Rebuild the session of a killed recorder: all that can be read, in a new file.

steerd recover SESSION.mcap

Reads SESSION.mcap.partial where the session never got its name.
"""

import argparse
from pathlib import Path

from steerd.daemon.cli.arguments import missing_partial, option
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.translate import reading


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "session", "SESSION", "an unfinished session file", missing_partial, type=Path)
    option(parser, "-o --output", "OUT.mcap", "default: NAME.recovered.mcap", type=Path)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.imports.import_session import check_output
    from steerd.daemon.sessions.info import load_session
    from steerd.daemon.sessions.text import print_warnings
    from steerd.steer_bus.session import recover

    partial = args.session.with_name(args.session.name + ".partial")
    source: Path = partial if partial.exists() and not args.session.exists() else args.session
    name = source.name.removesuffix(".partial").removesuffix(".mcap")
    out: Path = args.output or source.with_name(f"{name}.recovered.mcap")
    session = load_session(source)
    if session.info().finished and not session.warnings:
        print(f"{source} is complete: nothing to recover")
        return
    if not session.info().count:
        raise SteerdError(f"{source} holds no message that can be read", "", ExitCode.INVALID)
    check_output(out)
    with reading(source):
        report = recover(source, out)
    print_warnings([warning.message for warning in report.warnings])
    print(f"saved    {report.messages} messages, {session.info().duration_s:.1f} s")
    print(f"lost     {report.lost_bytes} unreadable bytes, and data not yet on the disk")
    print(f"longest  {report.longest_gap_s:.3g} s without any message")
    print(f"\nwritten: {report.path}\n   next: steerd info {report.path}")
