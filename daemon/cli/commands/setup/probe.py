"""Find VESCs, mocap servers and sockets; say what is wrong and what to do.

Nothing moves. A running `steerd run` holds its port: stop it first.

steerd probe
steerd probe --port /dev/ttyACM0 --mocap natnet://192.168.1.10/car
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from math import degrees

from steerd.daemon.cli.arguments import missing_car, option
from steerd.daemon.common.errors import ExitCode, SteerdError, refusing
from steerd.daemon.common.screen import clean, join_words, wrap
from steerd.daemon.setup.probe import VESC_USB, Advice, Found, MocapSeen, VescFound

NAME_MAX = 40  # characters of a body's name that are shown
ADVICE_MAX = 500  # characters of a finding that are shown
Rows = Iterable[tuple[str, str]]  # labels and what is said under them


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "--port", "DEV", "query this port only, whatever its USB id")
    option(parser, "--mocap", "URL", "listen to this source, as `steerd run`")
    option(parser, "--car", "FILE.toml", "car file: units, axes, cells, timeout", missing_car)
    option(parser, "--seconds", "S", "to listen to a mocap source", type=float, default=3.0)
    option(parser, "--json", "", "the same for programs")


def run(args: argparse.Namespace) -> int:
    """Print the findings; exit code 3 if what was named cannot be used, or nothing was found."""
    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.settings.config import load_settings
    from steerd.daemon.setup.probe_ask import ask_mocap, ask_ports, find_sockets, in_group
    from steerd.steer_bus.clock import MonotonicClock

    if not 0.5 <= args.seconds <= 600.0:
        raise SteerdError(f"--seconds {args.seconds:g}: 0.5 to 600", "", ExitCode.USAGE)
    settings, clock = load_settings(args.car or default_car_path()), MonotonicClock()
    serial = tuple(ask_ports(args.port, clock, settings.brakes))
    with refusing(f"--mocap {args.mocap}: "):
        mocap = tuple(ask_mocap(args.mocap, settings.ingest, clock, args.seconds))
    found = Found(serial, mocap, find_sockets(), in_group())
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
