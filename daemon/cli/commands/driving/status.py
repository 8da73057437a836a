"""State of a running daemon, and what it is waiting for."""

import argparse
import json
from collections.abc import Mapping

from steerd.daemon.cli.arguments import add_car_arguments, option
from steerd.daemon.common.screen import wrap
from steerd.daemon.ipc.operator import connect, read_model, read_status
from steerd.daemon.learning.text import design_text, encode_model, format_model
from steerd.steer_bus.clock import MonotonicClock

LABEL = 13  # columns of the labels


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_car_arguments(parser)
    option(parser, "--json", "", "for programs")


def run(args: argparse.Namespace) -> None:
    with connect(args.connect, args.lab) as bus:
        status = read_status(bus, args.name, MonotonicClock())
        model = read_model(bus, args.name)
    if args.json:
        print(json.dumps({**status, **(encode_model(model) if model else {})}, indent=2))
        return
    print("\n".join(format_status(args.name, status)))
    if model is not None:
        print("\n".join(format_model(model)))


def format_status(name: str, status: Mapping[str, str]) -> list[str]:
    """The status as lines of at most 80 columns.

    Args:
        name: of the car.
        status: diagnostics by name, as the daemon publishes them.
    """
    firmware, uuid = status.get("firmware", "?"), status.get("uuid", "?")
    items = [
        ("waiting for", status["waiting"]),
        *(("warning", text) for text in status.get("warnings", "").splitlines() if text),
        ("VESC", f"firmware {firmware}, timeout {status.get('vesc_timeout_ms', '?')} ms"),
        ("UUID", uuid),
        ("mocap", f"{status.get('mocap', '?')}, {status.get('mocap_rate_hz', '?')} Hz"),
        ("controller", status.get("controller", "?")),
        *((("design", design_text(status)),) if "design" in status else ()),
    ]
    lines = wrap(status["reason"], f"{name}: {status['state']} — ", " " * LABEL)
    for label, text in items:
        lines += wrap(text, f"{label + ':':<{LABEL}}", " " * LABEL)
    return lines
