"""A run as a systemd service or a ROS 2 launch file: their texts, and the unit's path. Pure."""

import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.setup.probe import UDEV_NAME, UDEV_RULE

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
