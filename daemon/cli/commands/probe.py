"""Commands that look at the hardware and at this machine before a drive."""

import json
import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from math import degrees

from steerd.daemon.cli.arguments import missing_car, option
from steerd.daemon.common.errors import ExitCode, UsageError, refusing
from steerd.daemon.common.screen import clean, join_words, wrap
from steerd.daemon.process import realtime
from steerd.daemon.process.guard import read_steal_ns
from steerd.daemon.settings.config import load_settings
from steerd.daemon.setup.probe import VESC_USB, Advice, Found, MocapSeen, VescFound
from steerd.steer_bus.clock import MonotonicClock

NAME_MAX = 40  # characters of a body's name that are shown
ADVICE_MAX = 500  # characters of a finding that are shown
STOLEN_SHARE = 0.001  # a host that takes more of the time than this is the first suspect
Rows = Iterable[tuple[str, str]]  # labels and what is said under them


def probe_arguments(parser: ArgumentParser) -> None:
    option(parser, "--port", "DEV", "query this port only, whatever its USB id")
    option(parser, "--mocap", "URL", "listen to this source, as `steerd run`")
    option(parser, "--car", "FILE.toml", "car file: units, axes, cells, timeout", missing_car)
    option(parser, "--seconds", "S", "to listen to a mocap source", type=float, default=3.0)
    option(parser, "--json", "", "the same for programs")


def probe(args: Namespace) -> int:
    """Find VESCs, mocap servers and sockets; say what is wrong and what to do.

    Nothing moves. A running `steerd run` holds its port: stop it first.

    steerd probe
    steerd probe --port /dev/ttyACM0 --mocap natnet://192.168.1.10/car
    """
    from steerd.daemon.setup.probe_ask import ask_mocap, ask_ports, find_sockets, in_dialout

    if not 0.5 <= args.seconds <= 600.0:
        raise UsageError(f"--seconds {args.seconds:g}: 0.5 to 600")
    settings, clock = load_settings(args.car), MonotonicClock()
    serial = tuple(ask_ports(args.port, clock, settings.brakes))
    with refusing(f"--mocap {args.mocap}: "):
        mocap = tuple(ask_mocap(args.mocap, settings.ingest, clock, args.seconds))
    found = Found(serial, mocap, find_sockets(), in_dialout())
    if args.json:
        document = {"schema": "steerd.probe/1", **asdict(found)}
        print(json.dumps(document, indent=1, ensure_ascii=False))
    else:
        print("\n".join(format_found(found)))
    vesc, poses = any(port.vesc for port in serial), any(seen.samples for seen in mocap)
    useless = (args.port and not vesc) or (args.mocap and not poses) or not (vesc or mocap)
    return ExitCode.UNREADABLE if useless else ExitCode.OK


def format_found(found: Found) -> Iterator[str]:
    """What was found, in lines of at most 80 columns."""
    yield "serial ports"
    if not found.serial:
        yield "  none: is the VESC powered, and its USB cable one that carries data?"
    for port in found.serial:
        head = f"{port.port}{f'  (USB {port.usb})' if port.usb else ''}"
        yield from _item(head, _vesc(port.vesc) if port.vesc else (), port.advice)
    if not found.in_dialout:
        yield "  ! you are not in the group dialout"
        yield "    try: sudo usermod -aG dialout $USER, then log out and in again"
    if any(port.vesc or port.usb == VESC_USB for port in found.serial):
        yield "  for the name /dev/vesc, and to keep ModemManager away from it:"
        yield "    steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules"
    yield "\nmotion capture"
    if not found.mocap:
        yield "  no NatNet server answered a discovery on this network"
        yield "    try: steerd probe --mocap natnet://HOST/BODY (or vrpn://HOST/BODY)"
    for seen in found.mocap:
        yield from _item(clean(seen.address), _source(seen), seen.advice)
    yield "\nopen sockets"
    if not found.sockets:
        yield "  none of zenoh, NatNet and VRPN: nothing is in the way"
    for item in found.sockets:
        yield f"  {item.kind} {item.address}:{item.port}  {item.meaning}"


def _vesc(v: VescFound) -> Rows:
    yield "VESC", f"{clean(v.hardware, 30)}, firmware {v.firmware[0]}.{v.firmware[1]:02d}"
    yield "UUID", f"{v.uuid or 'unknown'} (car file: [vesc] uuid)"
    if v.timeout_ms is not None:
        never = "never" if v.timeout_ms == 0 else f"{v.timeout_ms} ms"
        yield "timeout", f"{never}, then {v.timeout_brake_a:g} A brake current"
    electrics = [f"{v.voltage:.1f} V"] if v.voltage is not None else []
    electrics += [f"{v.temp_fet_c:.0f} °C"] if v.temp_fet_c is not None else []
    electrics += ["IMU answers" if v.imu else "no IMU"]
    yield "state", f"{', '.join(electrics)}, fault: {v.fault or 'none'}"
    if v.round_trip_ms is not None:
        yield "answers", f"{v.answered:.0%}, after {v.round_trip_ms:.1f} ms"


def _source(seen: MocapSeen) -> Rows:
    if seen.server:
        yield "server", clean(seen.server)
    if seen.bodies:
        yield "bodies", ", ".join(join_words(clean(body, NAME_MAX)) for body in seen.bodies)
    if seen.samples:
        of = f" of {seen.expected_rate_hz:.0f}" if seen.expected_rate_hz else ""
        yield "poses", f"{seen.rate_hz:.0f}{of} Hz, {seen.accepted} of {seen.samples} accepted"
    if seen.latency_ms is not None:
        sigma = "" if seen.clock_sigma_ms is None else f" ± {seen.clock_sigma_ms:.2f} ms"
        figures = (
            f"clock: {seen.clock}{sigma}",
            f"age on arrival: {seen.latency_ms:.1f} ms",
            f"jitter: {seen.jitter_ms:.1f} ms",
        )
        yield "time", ", ".join(map(join_words, figures))
    if seen.height is not None and seen.tilt is not None:
        yield "body", f"{seen.height:.3f} m high, tilted by {degrees(seen.tilt):.1f}°"


def _item(head: str, rows: Rows, advice: Sequence[Advice]) -> Iterator[str]:
    yield f"  {head}"
    for label, text in rows:
        yield from wrap(text, f"    {label:<10}", " " * 14)
    for item in advice:
        yield from wrap(clean(item.what, ADVICE_MAX), "    ! ", "      ")
        for i, line in enumerate(item.fix.splitlines()):
            head = "      try: " if i == 0 else "        "
            # An indented line is to be copied and stays as it is.
            yield from [head + line] if line.startswith(" ") else wrap(line, head, " " * 11)


def rtcheck_arguments(parser: ArgumentParser) -> None:
    option(parser, "--seconds", None, "how long to measure", type=float, default=10.0)
    option(parser, "--under-load", "", "keep every processor busy meanwhile")
    option(parser, "--rate", "HZ", "of the loop", type=float, default=100.0)


def rtcheck(args: Namespace) -> int:
    """Measure whether this machine can run a control loop on time.

    Run it beside everything that will run during a drive. The exit code is 5 where
    late ticks would stop a car, or nearly so.
    """
    if not (0.1 <= args.seconds <= 3600.0 and 20.0 <= args.rate <= 1000.0):
        hint = "--seconds 0.1 to 3600, --rate 20 to 1000"
        raise UsageError("--seconds or --rate is out of range", hint)
    print(f"measuring for {args.seconds:g} s …", file=sys.stderr, flush=True)
    period_ns = round(1e9 / args.rate)
    ticks = max(1, round(args.seconds * args.rate))
    report = realtime.enter_realtime()
    realtime.settle_memory()
    stolen_ns = -read_steal_ns()
    with realtime.keep_busy(os.cpu_count() or 1 if args.under_load else 0):
        late_ns = realtime.measure_wakes(MonotonicClock(), period_ns, ticks)
    stolen_ns += read_steal_ns()
    wakes = realtime.summarise_wakes(late_ns, period_ns)
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
