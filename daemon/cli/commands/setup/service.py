"""Run steerd as a service that starts disarmed: systemd's unit, ROS 2, udev.

steerd service install --user --port /dev/vesc --mocap natnet://HOST/car
steerd service print --port /dev/vesc --mocap natnet://HOST/car
steerd service launch --port /dev/vesc --mocap natnet://HOST/car
steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules

All options of `steerd run` are accepted and checked before anything is written.
"""

import argparse
import getpass
import os
import sys
from pathlib import Path

from steerd.daemon.cli.commands.driving import run as run_command
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do, for whom, and what to run."""
    parser.add_argument("action", choices=("install", "uninstall", "print", "launch", "udev"))
    whose = parser.add_mutually_exclusive_group()
    whose.add_argument("--user", action="store_true", help="your own service manager (default)")
    whose.add_argument("--system", action="store_true", help="the machine's; needs root")
    parser.add_argument("--force", action="store_true", help="replace a unit that is there")
    run_command.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write, remove or print.

    Raises:
        SteerdError: the options are wrong, a unit exists already, or a file cannot be written.
    """
    from steerd.daemon.cli.service import make_launch, make_unit, udev_text, unit_path

    user = not args.system
    path = unit_path(user)
    if args.action == "udev":
        print(udev_text(), end="")
        return ExitCode.OK
    if args.action == "uninstall":
        return _uninstall(path, user)
    command = _make_command(args)
    if args.action == "launch":
        print(make_launch(command), end="")
        return ExitCode.OK
    account = "" if user else os.environ.get("SUDO_USER") or getpass.getuser()
    text = make_unit(command, args.name, account=account)
    if args.action == "print":
        print(text, end="")
        return ExitCode.OK
    return _install(path, text, user, force=args.force)


def _make_command(args: argparse.Namespace) -> list[str]:
    """The command line of the run, checked.

    Raises:
        SteerdError: the options are wrong, or not those of a service.
    """
    from steerd.daemon.assembly.build import make_plan

    if args.fast or args.auto_arm:
        what = "a service starts disarmed and runs in real time"
        raise SteerdError(what, "leave out --fast and --auto-arm", ExitCode.USAGE)
    make_plan(run_command.make_options(args))
    return [sys.executable, "-m", "steerd", "run", *make_run_arguments(args)]


def make_run_arguments(args: argparse.Namespace) -> list[str]:
    """The options of `steerd run` that differ from their defaults, as arguments.

    A service has another working directory, so files are named in full.
    """
    parser = argparse.ArgumentParser()
    run_command.add_arguments(parser)
    arguments: list[str] = []
    for action in parser._actions:  # noqa: SLF001 (argparse has no public list)
        value = getattr(args, action.dest, action.default)
        if value == action.default or not action.option_strings:
            continue
        name = action.option_strings[0]
        if value is True:
            arguments.append(name)
        elif isinstance(value, list):
            arguments += [part for each in value for part in (name, str(each))]
        else:
            arguments += [name, _absolute(str(value), action.dest)]
    return arguments


def _absolute(text: str, dest: str) -> str:
    if dest in ("car", "record"):
        return str(Path(text).resolve())
    if dest == "path" and text.startswith("csv:"):
        file, comma, rest = text.removeprefix("csv:").partition(",")
        return f"csv:{Path(file).resolve()}{comma}{rest}"
    return text


def _install(path: Path, text: str, user: bool, *, force: bool) -> int:
    from steerd.daemon.common.whole_file import write_whole

    if path.exists() and path.read_text() != text and not force:
        raise SteerdError(f"{path} exists already", "--force replaces it", ExitCode.USAGE)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SteerdError(f"{path.parent}: {error.strerror}", "", ExitCode.UNREADABLE) from None
    write_whole(path, text)
    ctl = "systemctl --user" if user else "systemctl"
    print(f"{path}: written")
    print(f"   next: {ctl} daemon-reload && {ctl} enable --now steerd")
    print("   then: steerd status; it waits, disarmed, until `steerd arm`")
    print("   once: steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules")
    if user:
        print("   once: loginctl enable-linger, so that it starts without a login")
    return ExitCode.OK


def _uninstall(path: Path, user: bool) -> int:
    ctl = "systemctl --user" if user else "systemctl"
    try:
        path.unlink()
    except OSError as error:
        raise SteerdError(f"{path}: {error.strerror}", "", ExitCode.UNREADABLE) from None
    print(f"{path}: removed\n   next: {ctl} disable --now steerd; {ctl} daemon-reload")
    return ExitCode.OK
