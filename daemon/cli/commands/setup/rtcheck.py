"""Measure whether this machine can run a control loop on time.

Run it beside everything that will run during a drive. The exit code is 5 where
late ticks would stop a car, or nearly so.
"""

import argparse
import os
import sys

from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError

STOLEN_SHARE = 0.001  # a host that takes more of the time than this is the first suspect


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "--seconds", None, "how long to measure", type=float, default=10.0)
    option(parser, "--under-load", "", "keep every processor busy meanwhile")
    option(parser, "--rate", "HZ", "of the loop", type=float, default=100.0)


def run(args: argparse.Namespace) -> int:
    from steerd.daemon.process.guard import read_steal_ns
    from steerd.daemon.process.realtime import realtime_section
    from steerd.daemon.process.rtcheck import keep_busy, measure_wakes, summarise_wakes
    from steerd.steer_bus.clock import MonotonicClock

    if not (0.1 <= args.seconds <= 3600.0 and 20.0 <= args.rate <= 1000.0):
        hint = "--seconds 0.1 to 3600, --rate 20 to 1000"
        raise SteerdError("--seconds or --rate is out of range", hint, ExitCode.USAGE)
    print(f"measuring for {args.seconds:g} s …", file=sys.stderr, flush=True)
    period_ns = round(1e9 / args.rate)
    ticks = max(1, round(args.seconds * args.rate))
    with realtime_section() as report:
        stolen_ns = -read_steal_ns()
        with keep_busy(os.cpu_count() or 1 if args.under_load else 0):
            late_ns = measure_wakes(MonotonicClock(), period_ns, ticks)
        stolen_ns += read_steal_ns()
    wakes = summarise_wakes(late_ns, period_ns)
    print(f"fixed priority: {'yes' if report.fifo else 'no'}")
    print(f"locked memory:  {'yes' if report.locked else 'no'}")
    print(f"{wakes.ticks} wakes at {args.rate:g} Hz, late by")
    for name in ("p50", "p99", "p999", "worst"):
        print(f"  {name:<6}{getattr(wakes, name + '_ns') * 1e-6:8.3f} ms")
    print(f"missed: {wakes.missed}; later than 25 ms, which stops a car: {wakes.fatal}")
    print(f"taken by the host of this machine: {stolen_ns * 1e-6:.0f} ms")
    for line in report.refused:
        print(f"note: {line}")
    if wakes.good:
        print("this machine is fast enough")
        return ExitCode.OK
    if stolen_ns >= STOLEN_SHARE * args.seconds * 1e9:
        print("this virtual machine is stalled by its host: drive from a real one")
        return ExitCode.STOPPED
    print("this machine is too slow: close other programs, allow a fixed priority")
    return ExitCode.STOPPED
