"""What really happened on the wire and on the floor: judges of a drive that trust no daemon.

They read the bytes that reached the VESC and the car's true motion. A *drive* frame makes the motor
push, a *brake* frame slows it in whichever direction it turns, a *release* lets it coast. All pure.
"""

from collections.abc import Iterable, Sequence
from enum import Enum
from itertools import pairwise
from math import hypot
from typing import NamedTuple

from steerd.sim_hw.vesc.vesc_wire import Logged
from steerd.vesc_link.frames import FrameParser


class Effort(Enum):
    """What a motor frame asks of the motor."""

    DRIVE = "drive"
    BRAKE = "brake"
    RELEASE = "release"


class MotorFrame(NamedTuple):
    """One motor command on the wire; ``value`` is its own unit's magnitude (erpm, A, duty)."""

    t_ns: int
    effort: Effort
    value: float


class Motion(NamedTuple):
    """The true motion at one moment: position [m], speed [m/s]."""

    t_ns: int
    x: float
    y: float
    speed: float


_DUTY, _CURRENT, _BRAKE, _ERPM, _POSITION, _HANDBRAKE, _RELATIVE = 5, 6, 7, 8, 9, 10, 84
_COUNTS = {
    _DUTY: 1e5, _CURRENT: 1e3, _BRAKE: 1e3, _ERPM: 1.0, _POSITION: 1e6, _HANDBRAKE: 1e3,
    _RELATIVE: 1e5,
}  # fmt: skip
"""Ids of all commands that do something to the motor, with their counts per unit."""


def classify(payload: bytes) -> tuple[Effort, float] | None:
    """What a payload does to the motor; None for one that does nothing to it."""
    number = payload[0]
    if number not in _COUNTS or len(payload) < 5:
        return None
    value = abs(int.from_bytes(payload[1:5], "big", signed=True)) / _COUNTS[number]
    if number in (_ERPM, _POSITION):
        return Effort.DRIVE, value
    if number == _DUTY:
        return (Effort.DRIVE if value else Effort.BRAKE), value
    pulls = Effort.BRAKE if number in (_BRAKE, _HANDBRAKE) else Effort.DRIVE
    return (pulls if value else Effort.RELEASE), value


def read_motor_frames(log: Iterable[Logged]) -> tuple[MotorFrame, ...]:
    """Every motor command among the logged bytes that went to the VESC, in order."""
    parser, frames = FrameParser(), []
    for entry in log:
        if entry.to != "vesc":
            continue
        for payload in parser.feed(entry.data, entry.t_ns):
            effect = classify(payload)
            if effect is not None:
                frames.append(MotorFrame(entry.t_ns, *effect))
    return tuple(frames)


def find_stop(frames: Sequence[MotorFrame], t_ns: int, *, ramps: bool = True) -> MotorFrame | None:
    """The first stop frame from ``t_ns`` on, if nothing after it ever asks for more.

    A stop frame brakes or releases; with `ramps` it may also ask for less speed than the one before
    it.
    """
    first: MotorFrame | None = None
    for before, frame in reversed(list(zip((None, *frames), frames, strict=False))):
        if frame.t_ns < t_ns:
            break
        if frame.effort is not Effort.DRIVE:
            first = frame
        elif not (ramps and before and before.effort is Effort.DRIVE) or frame.value > before.value:
            break
        elif frame.value < before.value:
            first = frame
    return first


def count_drive_frames(frames: Iterable[MotorFrame], t_ns: int) -> int:
    """How many drive frames reached the VESC after ``t_ns``."""
    return sum(frame.effort is Effort.DRIVE and frame.t_ns > t_ns for frame in frames)


def distance_driven(track: Sequence[Motion], t_ns: int) -> float:
    """Distance driven since ``t_ns`` [m]."""
    moved = [motion for motion in track if motion.t_ns >= t_ns]
    return sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(moved))


def stopping_distance(speed: float, blind_s: float, decel: float) -> float:
    """Distance that a car needs which drives on for ``blind_s`` and then slows down [m]."""
    return speed * blind_s + speed * speed / (2.0 * decel)
