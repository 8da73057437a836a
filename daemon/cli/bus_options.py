"""Options of the commands that talk to a running daemon."""

import argparse
from pathlib import Path

from steerd.daemon.settings.run_options import RunOptions


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """Options for the daemon's endpoint and our certificates."""
    parser.add_argument(
        "--connect", metavar="ENDPOINT", help=f"the daemon's (default {RunOptions.listen})"
    )
    parser.add_argument("--lab", type=Path, metavar="DIR", help="our folder of `steerd keys`")
