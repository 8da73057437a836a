"""A drive as one HTML page: track, errors, commands and measurements, timing.

The page needs no network: send it by mail, or keep it beside the session.

steerd plot SESSION.mcap -o DRIVE.html
"""

import argparse
from pathlib import Path

from steerd.daemon.common.errors import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The session and the page."""
    parser.add_argument("session", type=Path, metavar="SESSION", help="a session file (.mcap)")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.html", help="default: beside the session"
    )


def run(args: argparse.Namespace) -> int:
    """Write the page and say where it is.

    Raises:
        SteerdError: the session cannot be read, or the page not be written.
    """
    from steerd.daemon.common.outputs import check_outputs
    from steerd.daemon.common.written import write_outputs
    from steerd.daemon.sessions.info import load_session, make_session_report
    from steerd.daemon.sessions.plot_data import make_drawing
    from steerd.daemon.sessions.plot_page import make_page
    from steerd.daemon.sessions.text import print_warnings

    session = load_session(args.session)
    output = args.output or args.session.with_suffix(".html")
    check_outputs({"-o": output})
    report = make_session_report(session)
    print_warnings(report.warnings)
    page = make_page(report, make_drawing(session))
    write_outputs({output: page})
    print(f"{output}: {len(page.encode()) / 1e6:.1f} MB; open it in a browser")
    return ExitCode.OK
