"""Options of a drive, as one value that goes to the processes as JSON."""

from dataclasses import dataclass
from enum import StrEnum

import msgspec


class ControllerKind(StrEnum):
    """Who steers: the built-in lane keeper, a program on the bus, or a ROS node's `/drive`."""

    LANE = "lane"
    ZENOH = "zenoh"
    ROS2 = "ros2"


@dataclass(frozen=True)
class RunOptions:
    """Options of one drive: those of `steerd run`, whose help explains them, by their names.

    Attributes:
        car_file: path of the TOML car file.
        car: the car's name in keys and file names.
        port, mocap: as the options; None in virtual time.
        duration_s: length of the drive [s]; None until stopped.
        record: session file, or None for a name made from date and car.
        rate_hz: control rate [Hz].
        auto_arm: arm and start without an operator (simulated hardware only).
        listen: zenoh endpoint of the gateway, or "" for none.
        drill: excitation plan of `steerd collect` (see `plans.parse_drill`), or "".
        lab: this machine's folder of `steerd keys`, or "" for plain loopback.
        page: port of the live page on loopback, 0 for a free one; None for no page.
        sim_car: car file of the simulated car, or `hidden:SEED`; "" for the car file's own car.
        view: ``[HOST:]PORT`` of the viewer's WebSocket, or "" for none.
    """

    car_file: str
    car: str = "car1"
    port: str | None = None
    mocap: str | None = None
    path: str = "figure8"
    speed: float = 1.0
    duration_s: float | None = None
    record: str | None = None
    seed: int = 0
    rate_hz: float = 100.0
    controller: ControllerKind = ControllerKind.LANE
    simulated: bool = False
    auto_arm: bool = False
    effects: tuple[str, ...] = ()
    listen: str = "tcp/127.0.0.1:7447"
    lab: str = ""
    insecure_lan: bool = False
    drill: str = ""
    view: str = ""
    ros_domain: int | None = None
    sim_car: str = ""
    page: int | None = None
    view_sets: bool = False
    learn: bool = False
    adapt: bool = False


def encode_options(options: RunOptions) -> str:
    """The options as JSON text."""
    return msgspec.json.encode(options).decode()


def decode_options(text: str) -> RunOptions:
    """The options of `encode_options`.

    Raises:
        msgspec.ValidationError: if the text is not such options.
    """
    return msgspec.json.decode(text, type=RunOptions)
