"""Options of a drive, as one value that goes to the processes as JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import msgspec

HIDDEN = "hidden:"  # begins the name of a car that a seed hides: `hidden:7`


class ControllerKind(StrEnum):
    """Who steers: the built-in lane keeper, a program on the bus, or a ROS node's `/drive`."""

    LANE = "lane"
    ZENOH = "zenoh"
    ROS2 = "ros2"


@dataclass(frozen=True)
class RunOptions:
    """Options of one drive: those of `steerd run`, whose help explains them, by their names."""

    car_file: str  # path of the TOML car file
    car: str = "car1"  # the car's name in keys and file names
    port: str | None = None  # None in virtual time
    mocap: str | None = None  # the same
    path: str = "figure8"
    speed: float = 1.0
    duration_s: float | None = None  # length of the drive [s]; None until stopped
    record: str | None = None  # session file, or None for a name made from date and car
    seed: int = 0
    rate_hz: float = 100.0  # control rate [Hz]
    controller: ControllerKind = ControllerKind.LANE
    simulated: bool = False
    auto_arm: bool = False  # arm and start without an operator (simulated hardware only)
    effects: tuple[str, ...] = ()
    listen: str = "tcp/127.0.0.1:7447"  # zenoh endpoint of the gateway
    lab: str = ""  # this machine's folder of `steerd keys`, or "" for plain loopback
    insecure_lan: bool = False
    drill: str = ""  # excitation plan of `steerd collect` (see `plans.parse_drill`), or ""
    view: str = ""  # ``[HOST:]PORT`` of the viewer's WebSocket, or "" for none
    ros_domain: int | None = None
    sim_car: str = ""  # car file of the simulated car, or `hidden:SEED`; "" for the car file's own
    page: int | None = None  # port of the live page on loopback, 0 for a free one; None for no page
    view_sets: bool = False
    learn: bool = False
    adapt: bool = False


def encode_options(options: RunOptions) -> str:
    """The options as JSON text."""
    return msgspec.json.encode(options).decode()


def decode_options(text: str) -> RunOptions:
    """The options of `encode_options`; a msgspec.ValidationError for another text."""
    return msgspec.json.decode(text, type=RunOptions)


def recorded_options(metadata: Mapping[str, Mapping[str, Any]]) -> RunOptions | None:
    """The options of a drive by its session's metadata; None where steerd did not drive."""
    try:
        return decode_options(metadata.get("steerd.session", {}).get("options", ""))
    except ValueError:
        return None
