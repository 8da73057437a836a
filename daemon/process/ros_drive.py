"""`--controller ros2`: a ROS 2 node's `/drive` steers the car, as any controller on the bus."""

import secrets

from steerd.car_model.state import State
from steerd.daemon.process.external_controller import (
    VALID_MS,
    ExternalController,
    Lane,
    while_driving,
)
from steerd.steer_bus.bus import Bus
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.messages import StateMessage
from steerd.steer_bus.ros_keys import make_ros_filter
from steerd.steer_bus.standard import AckermannDriveStamped

DRIVE_TOPIC = "/drive"
"""Where F1TENTH's controllers publish `ackermann_msgs/AckermannDriveStamped`."""


class RosDrive:
    """The node's commands, each repeated with every estimate for as long as a command is good.

    Limits, lease, watchdogs and the way to a stop are those of every external controller.
    """

    def __init__(self, bus: Bus, domain: int | None, boot_id: int) -> None:
        self._heard = bus.subscribe(make_ros_filter(domain, DRIVE_TOPIC))
        self._made = ExternalController(
            while_driving(self._command), boot_id, secrets.randbits(62) + 1
        )
        self._newest = 0.0, 0.0
        self._heard_ns: int | None = None

    def answer(self, state: StateMessage) -> bytes | None:
        """The command for an estimate as a `DriveCommand`; None where the node is silent."""
        for sample in self._heard.poll():
            try:
                drive = decode(AckermannDriveStamped, sample.data).drive
            except CodecError:
                continue
            self._newest = drive.steering_angle, drive.speed
            self._heard_ns = state.mono_ns
        if self._heard_ns is None or state.mono_ns - self._heard_ns > VALID_MS * 1_000_000:
            return None
        stamp = state.header.stamp
        realtime_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        command = self._made.compute_command(state, realtime_ns)
        return None if command is None else encode(command)

    def _command(self, t: float, state: State[float], lane: Lane) -> tuple[float, float]:
        return self._newest
