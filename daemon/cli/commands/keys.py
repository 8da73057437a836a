"""`steerd keys`: the people of a lab, and which folder goes to which machine."""

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, refusing
from steerd.steer_bus.lab import DEFAULT_PORT, Lab
from steerd.steer_bus.topics import check_car_name


def keys_arguments(parser: ArgumentParser) -> None:
    option(parser, "folder", "DIR", "the lab's folder", type=Path)
    option(parser, "--host", None, "the car's address or name in the lab's network")
    option(parser, "--port", None, "its TCP port", type=int, default=DEFAULT_PORT)
    option(parser, "--car", "NAME", "the car's name on the bus", default="car1")
    option(parser, "--operator", "NAME", "who may drive", action="append")
    option(parser, "--viewer", "NAME", "who may only watch", action="append")
    option(parser, "--years", None, "how long they hold (default 5)", type=float, default=5.0)


def keys(args: Namespace) -> None:
    """Certificates of a lab: for the car, its operators and its viewers.

    steerd keys lab --host 192.168.1.20 --operator desk --viewer screen

    makes a folder for each of them under ./lab. Copy a folder to its machine and
    name it there: `steerd run --lab lab/car1 …` on the car, `steerd start --lab
    desk` on the desk. Later, `steerd keys lab --operator new` adds somebody.
    """
    if not 0.0 < args.years <= 50.0 or not 0 < args.port < 65536:
        raise UsageError("--years: up to 50; --port: 1 to 65535")
    if args.host is not None and not args.host.strip():
        raise UsageError("--host is empty", "--host 192.168.1.20")
    try:
        from steerd.daemon.cli.certificates import add_members, load_members
    except ImportError:
        hint = "pip install cryptography, on this machine only"
        raise SteerdError("steerd keys needs cryptography", hint, ExitCode.UNREADABLE) from None
    began = args.host is not None
    operators, viewers = args.operator or (["operator"] if began else []), args.viewer
    if not (operators or viewers):
        hint = "steerd keys DIR --host ADDRESS, or --operator NAME to add to a lab"
        raise UsageError("nothing to make: no --host and no new name", hint)
    if began:
        with refusing(hint="--car car1"):
            car = check_car_name(args.car)
        host = f"[{args.host}]" if ":" in args.host and "[" not in args.host else args.host
        old = Lab(args.folder, car, f"tls/{host}:{args.port}")
    else:
        old = load_members(args.folder)
    drivers, watchers = (*old.operators, *operators), (*old.viewers, *viewers)
    lab = replace(old, operators=drivers, viewers=watchers)
    add_members(args.folder, old, lab, args.years, args.host)
    print(explain(args.folder, lab, began=began, added=(*operators, *viewers)))


def explain(folder: Path, lab: Lab, *, began: bool, added: tuple[str, ...]) -> str:
    """Which folder to copy to which machine."""
    car = f"to the car: steerd run --lab {lab.car} …"
    rows = {lab.car: car if began else "to the car again: lab.toml in it has the new names"}
    for name in added:
        drives = f"to who may drive: steerd arm --lab {name}, steerd start --lab {name}"
        watches = f"to who may watch: steerd watch --lab {name}"
        rows[name] = drives if name in lab.operators else watches
    rows["authority"] = "keep it safe: its owner can make operators"
    width = max(len(str(folder / name)) for name in rows)
    lines = [f"{folder / name!s:<{width}}  {what}\n" for name, what in rows.items()]
    return "".join(lines) + (
        f"\nThe car listens on {lab.endpoint}.\n"
        "Copy with `scp -rp`, which keeps the keys private.\n"
        "To remove somebody, delete the name from lab.toml on the car and restart steerd."
    )
