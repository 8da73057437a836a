"""Contents of a session: car, time, states, motion, topics, and how it ended.

steerd info SESSION.mcap
steerd info SESSION.mcap --json
"""

import argparse

from steerd.daemon.cli.arguments import add_session, option, pick_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session(parser)
    option(parser, "--json", "", "the same for programs")


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.text import format_report, make_json, print_warnings

    report = make_session_report(load_recording(pick_session(args.session)))
    if args.json:
        import json

        print(json.dumps(make_json(report), indent=1, allow_nan=False))
        return
    print(format_report(report))
    print_warnings(report.warnings)
