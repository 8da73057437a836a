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
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from steerd.daemon.cli.arguments import option
from steerd.daemon.cli.commands.driving import run as run_command
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.setup.probe import UDEV_NAME, UDEV_RULE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do, for whom, and what to run."""
    option(parser, "action", None, "", choices=("install", "uninstall", "print", "launch", "udev"))
    whose = parser.add_mutually_exclusive_group()
    option(whose, "--user", "", "your own service manager (default)")
    option(whose, "--system", "", "the machine's; needs root")
    option(parser, "--force", "", "replace a unit that is there")
    run_command.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write, remove or print."""
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
    from steerd.daemon.common.written import write_whole

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


WATCHDOG_S = 5
"""The loop reports once a second; systemd restarts one that is silent for this long [s]. The
guardian has braked the car long before."""
STOP_S = 20
"""Time for an orderly stop, in which the car comes to rest first [s]."""

_UNIT = """\
# Made by `steerd service install`. It starts disarmed, after each restart too:
# arm it with `steerd arm`, start it with `steerd start`, see it with
# `steerd watch`.
[Unit]
Description=steerd, control loop of {car}
Documentation=man:systemd.service(5)
StartLimitIntervalSec=60
StartLimitBurst=10

[Service]
Type=notify
NotifyAccess=all
ExecStart={command}
WatchdogSec={watchdog}
# A port or a mocap server that is not there yet is worth another try; a wrong
# option is not.
Restart=on-failure
RestartSec=3
RestartPreventExitStatus=2 4
# Only the parent gets the signal; it brings the car to rest and then ends the
# other processes.
KillMode=mixed
KillSignal=SIGTERM
TimeoutStopSec={stop}
StateDirectory=steerd
Environment=OPENBLAS_NUM_THREADS=1 PYTHONUNBUFFERED=1
LimitRTPRIO=80
LimitMEMLOCK=infinity
NoNewPrivileges=yes
UMask=0077
{protected}
[Install]
WantedBy={wanted}
"""


_PROTECTED = """\
# The car's port needs no root: the account is of the group that the udev file names.
User={account}
ProtectSystem=full
"""
"""Of the system's manager alone: a user's own cannot change accounts or mounts."""


def make_unit(command: Sequence[str], car: str, *, account: str = "") -> str:
    """The unit file's text.

    Args:
        command: what is run, program first.
        car: its name, for the description.
        account: who it runs as under the system's service manager; empty for one's own.

    Raises:
        SteerdError: an argument cannot be written in a unit file.
    """
    for text in (*command, car, account):
        if any(c in text for c in "\n\r\0"):
            raise SteerdError(f"{text!r} cannot be written in a unit file", "", ExitCode.USAGE)
    return _UNIT.format(
        car=car,
        command=" ".join(_quote(part) for part in command),
        watchdog=WATCHDOG_S,
        stop=STOP_S,
        protected=_PROTECTED.format(account=account) if account else "",
        wanted="multi-user.target" if account else "default.target",
    )


_LAUNCH = """\
<!-- Made by `steerd service launch`. ros2 launch steerd.launch.xml; it starts
     disarmed. On shutdown it gets SIGINT, which brings the car to rest, and
     {stop} s for it. -->
<launch>
  <executable output="screen" sigterm_timeout="{stop}" sigkill_timeout="{stop}"
    cmd={command}/>
</launch>
"""


def make_launch(command: Sequence[str]) -> str:
    """A ROS 2 launch file for the same command line.

    Raises:
        SteerdError: an argument holds what a launch file would substitute.
    """
    for text in command:
        if "$(" in text or any(c in text for c in "\n\r\0"):
            what = f"{text!r} cannot be written in a launch file"
            raise SteerdError(what, "", ExitCode.USAGE)
    # A line's end within an attribute reads as a space, which is what stands between arguments.
    lines = _pair_up(list(map(shlex.quote, command)))
    text = "\n      ".join(escape(line, {'"': "&quot;"}) for line in lines)
    return _LAUNCH.format(command=f'"{text}"', stop=STOP_S)


def _pair_up(parts: Sequence[str]) -> list[str]:
    """The words before the first option, then each option with its value."""
    lines = [parts[0]]
    for part in parts[1:]:
        if part.startswith("--") or (part == "-m" and len(lines) == 1):
            lines.append(part)
        else:
            lines[-1] += f" {part}"
    return lines


def _quote(part: str) -> str:
    """An argument in systemd's syntax: `%` and `$` are special, and escapes hold in all quotes."""
    plain = part.replace("%", "%%").replace("$", "$$")
    if shlex.quote(plain) == plain:
        return plain
    escaped = plain.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def unit_path(user: bool, environment: Mapping[str, str] = os.environ) -> Path:
    """The path of the unit file."""
    if not user:
        return Path("/etc/systemd/system/steerd.service")
    base = environment.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(base) / "systemd" / "user" / "steerd.service"


def udev_text() -> str:
    """The udev file: a stable name, no ModemManager, rights for the group dialout."""
    return f"# VESC motor controllers: /dev/vesc; belongs in {UDEV_NAME}\n{UDEV_RULE}\n"
