"""Certificates of a lab: for the car, its operators and its viewers.

steerd keys lab --host 192.168.1.20 --operator desk --viewer screen

makes a folder for each of them under ./lab. Copy a folder to its machine and
name it there: `steerd run --lab lab/car1 …` on the car, `steerd start --lab
desk` on the desk. Later, `steerd keys lab --operator new` adds somebody.
"""

import argparse
import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.bus import BusError
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.lab import DEFAULT_PORT, Lab, read_members
from steerd.steer_bus.topics import check_car_name

ROSTER = "lab.toml"  # members of the lab, in each folder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "folder", "DIR", "the lab's folder", type=Path)
    option(parser, "--host", None, "the car's address or name in the lab's network")
    option(parser, "--port", None, "its TCP port", type=int, default=DEFAULT_PORT)
    option(parser, "--car", "NAME", "the car's name on the bus", default="car1")
    option(parser, "--operator", "NAME", "who may drive", action="append")
    option(parser, "--viewer", "NAME", "who may only watch", action="append")
    option(parser, "--years", None, "how long they hold (default 5)", type=float, default=5.0)


def run(args: argparse.Namespace) -> None:
    if not 0.0 < args.years <= 50.0 or not 0 < args.port < 65536:
        raise SteerdError("--years: up to 50; --port: 1 to 65535", "", ExitCode.USAGE)
    if args.host is not None and not args.host.strip():
        raise SteerdError("--host is empty", "--host 192.168.1.20", ExitCode.USAGE)
    try:
        import steerd.daemon.cli.certificates  # noqa: F401
    except ImportError:
        hint = "pip install cryptography, on this machine only"
        raise SteerdError("steerd keys needs cryptography", hint, ExitCode.UNREADABLE) from None
    began = args.host is not None
    args.operator = args.operator or (["operator"] if began else [])
    added = (*args.operator, *args.viewer)
    if not added:
        hint = "steerd keys DIR --host ADDRESS, or --operator NAME to add to a lab"
        raise SteerdError("nothing to make: no --host and no new name", hint, ExitCode.USAGE)
    old = _begin_lab(args) if began else _read_lab(args.folder)
    _check_names(old, added)  # of all, before anything is written
    operators, viewers = (*old.operators, *args.operator), (*old.viewers, *args.viewer)
    lab = replace(old, operators=operators, viewers=viewers)
    _issue_all(args, lab.car if began else None, added)
    _write_rosters(args.folder, lab, added, car_new=began)
    print(explain(args.folder, lab, began=began, added=added))


def _begin_lab(args: argparse.Namespace) -> Lab:
    """A lab without people."""
    try:
        car = check_car_name(args.car)
    except ValueError as error:
        raise SteerdError(str(error), "--car car1", ExitCode.USAGE) from None
    host = f"[{args.host}]" if ":" in args.host and "[" not in args.host else args.host
    return Lab(args.folder, car, f"tls/{host}:{args.port}")


def _check_names(lab: Lab, added: tuple[str, ...]) -> None:
    from steerd.daemon.cli.certificates import check_name

    known = {lab.car, *lab.operators, *lab.viewers}
    for name in map(check_name, added):
        if name in known:
            hint = "choose another name; a certificate is never replaced"
            raise SteerdError(f"{name!r} exists already", hint, ExitCode.USAGE)
        known.add(name)


def _issue_all(args: argparse.Namespace, new_car: str | None, added: tuple[str, ...]) -> None:
    """Certificates for people, of a new lab for its car too."""
    from steerd.daemon.cli.certificates import issue, load_authority, make_authority

    now = datetime.fromtimestamp(MonotonicClock().realtime_ns() * 1e-9).astimezone()
    if new_car is None:
        issuer = load_authority(args.folder)
    else:
        issuer = make_authority(args.folder, new_car, now, args.years)
        issue(args.folder, issuer, new_car, args.host, now, args.years)
    for name in added:
        issue(args.folder, issuer, name, None, now, args.years)


def _read_lab(folder: Path) -> Lab:
    from steerd.daemon.cli.certificates import AUTHORITY

    try:
        return read_members(folder / AUTHORITY)
    except BusError as error:
        hint = "steerd keys DIR --host ADDRESS makes a lab"
        raise SteerdError(str(error), hint, ExitCode.UNREADABLE) from None


def _write_rosters(folder: Path, lab: Lab, added: tuple[str, ...], *, car_new: bool) -> None:
    from steerd.daemon.cli.certificates import AUTHORITY, write_private

    text = "# Made by steerd keys. The car admits only the names in its copy of this list.\n"
    for key in ("car", "endpoint", "operators", "viewers"):
        text += f"{key} = {json.dumps(getattr(lab, key))}\n"
    for name in (*added, AUTHORITY, lab.car):
        if (folder / name).is_dir():
            data = f"{text}name = {json.dumps(name)}\n".encode()
            write_private(folder / name / ROSTER, data, new=car_new or name in added)


def explain(folder: Path, lab: Lab, *, began: bool, added: tuple[str, ...]) -> str:
    """Which folder to copy to which machine."""
    car = folder / lab.car
    width = max(len(str(folder / name)) for name in (lab.car, "authority", *added))
    what = f"to the car: steerd run --lab {lab.car} …"
    if not began:
        what = f"to the car again: {ROSTER} in it has the new names"
    lines = [f"{car!s:<{width}}  {what}"]
    for name in added:
        if name in lab.operators:
            what = f"to who may drive: steerd arm --lab {name}, steerd start --lab {name}"
        else:
            what = f"to who may watch: steerd watch --lab {name}"
        lines.append(f"{folder / name!s:<{width}}  {what}")
    lines.append(f"{folder / 'authority'!s:<{width}}  keep it safe: its owner can make operators")
    lines += [
        "",
        f"The car listens on {lab.endpoint}.",
        "Copy with `scp -rp`, which keeps the keys private.",
        f"To remove somebody, delete the name from {ROSTER} on the car and restart steerd.",
    ]
    return "\n".join(lines)
