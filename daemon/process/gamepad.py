"""Gamepads as a stream of the kernel's input events, and what their parts mean. `evdev` lives here.

A device node is read with its axes' ranges and its end; a pipe carries the same events as bytes,
from another computer (`ssh pad cat /dev/input/event5`) or from a recording. The deadman is released
when its button is let go, when events were lost, and when the gamepad has been silent for too long.
"""

import contextlib
import os
import stat
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from steerd.daemon.common.errors import ExitCode, SteerdError

FOLDER = Path("/dev/input")
EVENT = struct.Struct("llHHi")
"""`struct input_event` of a 64-bit kernel: seconds, microseconds, type, code, value."""
KEY, ABS, SYN = 1, 3, 0  # event types: a button, an axis, the end of a report
SYN_DROPPED = 3  # code of SYN: the kernel's buffer ran over
_READ_BYTES = 64 * EVENT.size


class PadGoneError(Exception):
    """The gamepad was unplugged, or its stream has ended."""


class PadEvent(NamedTuple):
    """One input event."""

    type: int
    code: int
    value: int


class AxisRange(NamedTuple):
    """What an axis can report, and where it counts as at rest."""

    low: int
    high: int
    flat: int = 0


STICK, TRIGGER = AxisRange(-32768, 32767, 1500), AxisRange(0, 1023)
XBOX_AXES: Mapping[int, AxisRange] = {
    0: STICK, 1: STICK, 2: TRIGGER, 3: STICK, 4: STICK, 5: TRIGGER,
}  # fmt: skip
"""Ranges of the pads that the kernel's `xpad` drives, for streams, which have no others."""


@dataclass
class Pad:
    """The kernel's events as bytes; `fd` is readable when some are there."""

    name: str
    fd: int
    axes: Mapping[int, AxisRange] = field(default_factory=lambda: XBOX_AXES)
    _rest: bytes = b""

    def read(self) -> list[PadEvent]:
        """The events that are there; PadGoneError when no more will come."""
        try:
            data = os.read(self.fd, _READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:  # unplugged
            data = b""
        if not data:
            raise PadGoneError(self.name)
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        return [PadEvent(*event[2:]) for event in EVENT.iter_unpack(data[:whole])]

    def close(self) -> None:
        """Let it go."""
        os.close(self.fd)


def open_pad(path: Path | None, deadman: int) -> Pad:
    """The named gamepad or pipe, or the only gamepad that has the deadman's button.

    Raises:
        SteerdError: there is none, there are several, or it cannot be read.
    """
    if path is not None and path.exists() and stat.S_ISFIFO(path.stat().st_mode):
        return Pad(str(path), os.open(path, os.O_RDONLY))
    if find_spec("evdev") is None:
        hint = "pip install 'evdev-binary>=2' (or `pip install -e '.[gamepad]'` in the checkout)"
        raise SteerdError("a gamepad needs the package evdev", hint, ExitCode.UNREADABLE)
    return _open_device(path if path is not None else find_pad(deadman))


def _open_device(path: Path) -> Pad:
    """A device node of the kernel, read with the ranges of its axes."""
    import evdev  # noqa: TID251

    try:
        with contextlib.closing(evdev.InputDevice(str(path))) as device:
            axes: list[Any] = list(device.capabilities().get(ABS, []))
            ranges = {code: AxisRange(info.min, info.max, info.flat) for code, info in axes}
            return Pad(str(device.name), os.dup(device.fd), ranges)
    except PermissionError:
        hint = "sudo usermod -aG input $USER, and log in anew"
        raise SteerdError(f"{path}: no permission to read it", hint, ExitCode.UNREADABLE) from None
    except OSError as error:
        hint = "is it plugged in? `ls /dev/input/by-id` shows gamepads that are"
        what = f"{path}: {error.strerror or error}"
        raise SteerdError(what, hint, ExitCode.UNREADABLE) from None


def find_pad(deadman: int) -> Path:
    """The only device that has the deadman's button; SteerdError for none and for several."""
    import evdev  # noqa: TID251

    found = []
    for name in sorted(evdev.list_devices(str(FOLDER))):
        device = evdev.InputDevice(name)
        if deadman in device.capabilities().get(KEY, []):
            found.append(Path(name))
        device.close()
    if len(found) == 1:
        return found[0]
    if not found:
        hint = "plug one in, or name it with --device; reading one needs the group `input`"
        raise SteerdError("there is no gamepad", hint, ExitCode.UNREADABLE)
    listed = ", ".join(map(str, found))
    raise SteerdError("there are several gamepads", f"--device, one of {listed}", ExitCode.USAGE)


BUTTONS = {
    "south": 304, "east": 305, "north": 307, "west": 308, "tl": 310, "tr": 311, "tl2": 312,
    "tr2": 313, "select": 314, "start": 315,
}  # fmt: skip
"""Buttons by the end of the kernel's name, `BTN_TL` as `tl`."""
AXES = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5, "gas": 9, "brake": 10}
"""Axes by the end of the kernel's name, `ABS_RZ` as `rz`."""
TRIGGERS = ("z", "rz", "gas", "brake")
"""Axes that rest at their lowest value; the others rest in the middle."""
DEAD_ZONE = 0.05  # least dead zone of an axis in the middle, as a share of its half


@dataclass(frozen=True)
class PadMap:
    """What the gamepad's parts mean."""

    deadman: int = BUTTONS["tl"]  # code of a button, as the next two
    go: int = BUTTONS["start"]
    estop: int = BUTTONS["east"]
    steer: str = "x"  # name of an axis, as the next
    speed: str = "rz"
    steer_max: float = 0.34  # angle at the steering axis's end [rad]
    speed_max: float = 1.0  # at the speed axis's end [m/s]
    quiet_ns: int = 2_000_000_000  # a pad that says nothing for so long is released


@dataclass(frozen=True)
class PadState:
    """What is known of the gamepad."""

    held: bool = False  # whether the deadman's button is held
    steer: float = 0.0  # of its axis, -1 to 1
    speed: float = 0.0  # of its axis, 0 to 1
    heard_ns: int = 0  # time of the last event


def take_event(
    pad: PadState, event: PadEvent, pads: PadMap, axes: Mapping[int, AxisRange], t_ns: int
) -> tuple[PadState, int | None]:
    """The state after an event, and the button of the map that was pressed, if any."""
    pad = replace(pad, heard_ns=t_ns)
    if event.type == SYN and event.code == SYN_DROPPED:
        return replace(pad, held=False), None  # the release may be among what was lost
    if event.type == KEY and event.code == pads.deadman:
        return replace(pad, held=event.value != 0), None
    if event.type == KEY and event.code in (pads.go, pads.estop):
        return pad, event.code if event.value == 1 else None
    if event.type == ABS and event.code == AXES[pads.steer]:
        return replace(pad, steer=-read_axis(event.value, axes[event.code], pads.steer)), None
    if event.type == ABS and event.code == AXES[pads.speed]:
        value = read_axis(event.value, axes[event.code], pads.speed)
        forward = value if pads.speed in TRIGGERS else -value  # a stick's forward is up
        return replace(pad, speed=max(forward, 0.0)), None
    return pad, None


def read_axis(value: int, span: AxisRange, name: str) -> float:
    """An axis as 0 to 1 (a trigger) or -1 to 1 (a stick, 0 in its dead zone)."""
    width = max(span.high - span.low, 1)
    share = min(max((value - span.low) / width, 0.0), 1.0)
    if name in TRIGGERS:
        return share
    centred = 2.0 * share - 1.0
    dead = max(DEAD_ZONE, 2.0 * span.flat / width)
    if abs(centred) <= dead:
        return 0.0
    return (abs(centred) - dead) / (1.0 - dead) * (1.0 if centred > 0.0 else -1.0)


def is_silent(pad: PadState, pads: PadMap, t_ns: int) -> bool:
    """Whether a held pad has said nothing for too long: a wireless one may be gone."""
    return pad.held and t_ns - pad.heard_ns > pads.quiet_ns
