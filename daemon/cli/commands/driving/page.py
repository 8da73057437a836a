"""A running car as a live page in a browser on this machine.

steerd page
steerd page --lab console          # the car is elsewhere, in the lab

The page shows track, lane, errors, speed, battery and what the car waits for.
Whoever arms the car there holds it: close or leave the page and it stops.
`steerd run --page` starts the same for its own car.
"""

import argparse
import asyncio
import sys

from steerd.daemon.cli.arguments import add_car_arguments, option
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_car_arguments(parser)
    option(parser, "--path", None, "the lane to draw, as --path of run")
    option(parser, "--port", "N", "of the page (default: a free one)", type=int, default=0)


def run(args: argparse.Namespace) -> None:
    from steerd.daemon.ipc.operator import connect, read_lab

    if args.lab is not None:
        read_lab(args.lab)  # a folder that is none is refused before anything heavy is loaded
    from steerd.daemon.process.page import make_page, run_page
    from steerd.daemon.process.page_link import CarView
    from steerd.daemon.process.view_job import make_lane_job
    from steerd.steer_bus.clock import MonotonicClock

    page = make_page({"car": args.name, **make_lane_job(args.path)})

    def on_open(url: str) -> None:
        print(f"page: {url}", flush=True)
        print("open it in a browser on this machine; Ctrl-C ends it", file=sys.stderr)

    with connect(args.connect, args.lab) as bus:
        view = CarView(bus, args.name, MonotonicClock())
        try:
            asyncio.run(run_page(view, page, args.port, on_open, asyncio.Event()))
        except KeyboardInterrupt:
            pass
        except OSError as error:
            what = f"--port {args.port}: {error.strerror or error}"
            raise SteerdError(what, "name another port", ExitCode.UNREACHABLE) from None
