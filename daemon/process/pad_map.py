"""What the buttons and axes of a gamepad mean, and what counts as letting go of it. Pure.

The deadman is released when its button is let go, when events were lost, and when the gamepad has
been silent for too long.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from steerd.daemon.process.gamepad import ABS, KEY, SYN, SYN_DROPPED, AxisRange, PadEvent

BUTTONS = {
    "south": 304, "east": 305, "north": 307, "west": 308, "tl": 310, "tr": 311, "tl2": 312,
    "tr2": 313, "select": 314, "start": 315,
}  # fmt: skip
"""Buttons by the end of the kernel's name, `BTN_TL` as `tl`."""
AXES = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5, "gas": 9, "brake": 10}
"""Axes by the end of the kernel's name, `ABS_RZ` as `rz`."""
TRIGGERS = ("z", "rz", "gas", "brake")
"""Axes that rest at their lowest value; the others rest in the middle."""
DEAD_ZONE = 0.05
"""Least dead zone of an axis in the middle, as a share of its half."""


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
