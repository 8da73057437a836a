"""What a running daemon does, and what it waits for."""

import argparse
import json

from steerd.daemon.cli.commands.driving.operate import add_car_arguments
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.ipc.operator import connect, read_status
from steerd.steer_bus.clock import MonotonicClock


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd status`."""
    add_car_arguments(parser)
    parser.add_argument("--json", action="store_true", help="for programs")


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    with connect(args) as bus:
        status = read_status(bus, args.name, MonotonicClock())
    if args.json:
        print(json.dumps(status, indent=2))
        return ExitCode.OK
    print(f"{args.name}: {status['state']} — {status['reason']}")
    print(f"waits for: {status['waiting']}")
    for warning in filter(None, status.get("warnings", "").splitlines()):
        print(f"warning:   {warning}")
    vesc = f"firmware {status.get('firmware', '?')}, UUID {status.get('uuid', '?')}"
    print(f"VESC:      {vesc}, own timeout {status.get('vesc_timeout_ms', '?')} ms")
    print(f"mocap:     {status.get('mocap', '?')}, {status.get('mocap_rate_hz', '?')} Hz")
    print(f"steered by {status.get('controller', '?')} controller")
    return ExitCode.OK
