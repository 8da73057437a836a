"""What really happened on the wire and on the floor: judges of a drive that trust no daemon.

They read the bytes that reached the VESC and the car's true motion. A *drive* frame makes the motor
push, a *brake* frame slows it in whichever direction it turns, a *release* lets it coast. All pure.
"""

from collections.abc import Iterable, Sequence
from enum import Enum
from itertools import pairwise
from math import hypot, inf
from typing import NamedTuple

from steerd.sim_hw.plant.device import Logged
from steerd.vesc_link import commands as c
from steerd.vesc_link.frames import FrameParser
from steerd.vesc_link.ids import FW_6_05, Firmware
from steerd.vesc_link.packets import decode_command


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


def classify(command: c.Command) -> tuple[Effort, float] | None:
    """What a command does to the motor; None for one that does nothing to it."""
    match command:
        case c.SetErpm():
            return Effort.DRIVE, abs(command.erpm)
        case c.SetCurrent():
            return (Effort.DRIVE if command.current else Effort.RELEASE), abs(command.current)
        case c.SetDuty():
            return (Effort.DRIVE if command.duty else Effort.BRAKE), abs(command.duty)
        case c.SetCurrentBrake() | c.SetHandbrake():
            return (Effort.BRAKE if command.current else Effort.RELEASE), abs(command.current)
        case c.SetPos():
            return Effort.DRIVE, inf
        case c.SetCurrentRel():
            return (Effort.DRIVE if command.ratio else Effort.RELEASE), abs(command.ratio)
        case _:
            return None


def read_motor_frames(
    log: Iterable[Logged], firmware: Firmware = FW_6_05
) -> tuple[MotorFrame, ...]:
    """Every motor command among the logged bytes that went to the VESC, in order."""
    parser, frames = FrameParser(), []
    for entry in log:
        if entry.to != "vesc":
            continue
        for payload in parser.feed(entry.data, entry.t_ns):
            command = decode_command(payload, firmware)
            effect = classify(command) if command is not None else None
            if effect is not None:
                frames.append(MotorFrame(entry.t_ns, *effect))
    return tuple(frames)


def find_stop(frames: Sequence[MotorFrame], t_ns: int) -> MotorFrame | None:
    """The first stop frame from ``t_ns`` on, if nothing after it ever asks for more.

    A stop frame brakes, releases, or asks for less speed than the frame before it.
    """
    first: MotorFrame | None = None
    for before, frame in reversed(list(pairwise(frames))):
        if frame.t_ns < t_ns:
            break
        if frame.effort is not Effort.DRIVE:
            first = frame
        elif before.effort is not Effort.DRIVE or frame.value > before.value:
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
