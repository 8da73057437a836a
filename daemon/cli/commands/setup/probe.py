"""Find VESCs, mocap servers and sockets; say what is wrong and what to do.

Nothing moves. A running `steerd run` holds its port: stop it first.

steerd probe
steerd probe --port /dev/ttyACM0 --mocap natnet://192.168.1.10/car
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import missing_car, option
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.setup.probe import VESC_USB, Advice, MocapSeen, SerialFound

if TYPE_CHECKING:
    from steerd.daemon.settings.config import BrakeSettings
    from steerd.mocap_link.ingest import IngestConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Where to look."""
    option(parser, "--port", "DEV", "query this port only, whatever its USB id")
    option(parser, "--mocap", "URL", "listen to this source, as `steerd run`")
    option(parser, "--car", "FILE.toml", "car file: units, axes, cells, timeout", missing_car)
    option(parser, "--seconds", "S", "to listen to a mocap source", type=float, default=3.0)
    option(parser, "--json", "", "the same for programs")


def run(args: argparse.Namespace) -> int:
    """Print the findings; exit code 3 if what was named cannot be used, or nothing was found."""
    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.settings.config import load_settings
    from steerd.daemon.setup.probe_ask import find_sockets, in_group
    from steerd.daemon.setup.probe_text import format_mocap, format_serial, format_sockets

    if not 0.5 <= args.seconds <= 600.0:
        raise SteerdError(f"--seconds {args.seconds:g}: 0.5 to 600", "", ExitCode.USAGE)
    settings = load_settings(args.car or default_car_path())
    serial = list(_serial(args.port, settings.brakes))
    mocap = list(_mocap(args.mocap, settings.ingest, args.seconds))
    sockets, may_open = find_sockets(), in_group()
    if args.json:
        document = {
            "schema": "steerd.probe/1",
            "serial": [asdict(port) for port in serial],
            "mocap": [{**asdict(seen), "advice": [asdict(a) for a in adv]} for seen, adv in mocap],
            "sockets": [asdict(item) for item in sockets],
            "in_dialout": may_open,
        }
        print(json.dumps(document, indent=1, ensure_ascii=False))
    else:
        print("\n".join([*format_serial(serial, may_open), "", *format_mocap(mocap), "",
                         *format_sockets(sockets)]))  # fmt: skip
    useless = args.port and not any(port.vesc for port in serial)
    useless = useless or (args.mocap and not any(seen.samples for seen, _ in mocap))
    nothing = not any(port.vesc for port in serial) and not mocap
    return ExitCode.UNREADABLE if useless or nothing else ExitCode.OK


def _serial(port: str | None, brakes: "BrakeSettings") -> Iterator[SerialFound]:
    from steerd.daemon.setup.probe_ask import ask_port, find_ports, skip_port
    from steerd.steer_bus.clock import MonotonicClock

    clock = MonotonicClock()
    if port is not None:
        yield ask_port(port, find_ports().get(port, ""), clock, brakes)
        return
    for name, usb in find_ports().items():
        known = usb in (VESC_USB, "")
        yield ask_port(name, usb, clock, brakes) if known else skip_port(name, usb)


def _mocap(
    text: str | None, config: "IngestConfig", seconds: float
) -> Iterator[tuple[MocapSeen, tuple[Advice, ...]]]:
    from steerd.daemon.setup.probe import judge_mocap
    from steerd.daemon.setup.probe_ask import discover, watch_mocap
    from steerd.mocap_link.mocap_url import parse_mocap_url
    from steerd.steer_bus.clock import MonotonicClock

    clock = MonotonicClock()
    addresses = [text] if text else [f"natnet://{host}/-" for host in discover(clock)]
    for address in addresses:
        try:
            url = parse_mocap_url(address)
            seen = watch_mocap(url, address, config, clock, seconds)
        except ValueError as error:
            raise SteerdError(f"--mocap {address}: {error}", "", ExitCode.USAGE) from None
        except OSError as error:
            seen = MocapSeen(address, detail=str(error))
        yield seen, tuple(judge_mocap(seen, named=text is not None))
