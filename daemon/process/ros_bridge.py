"""The car as a ROS 2 node for rmw_zenoh: its topics once more, under ROS's keys."""

import contextlib
from typing import Any, Protocol

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.steer_bus import topics
from steerd.steer_bus.bus import Bus, BusError, Token
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import Actuation
from steerd.steer_bus.ros_keys import make_gid, make_node_token, make_publisher_token, make_ros_key
from steerd.steer_bus.standard import AckermannDrive, AckermannDriveStamped
from steerd.steer_bus.topics import TOPICS, Direction, make_key

DRIVE_NAME = "drive"
"""What went to the motor controller, as `ackermann_msgs/AckermannDriveStamped`."""
_FIRST_ENTITY = 10
"""Entity number of the first publisher."""


class RosBus(Bus, Protocol):
    """A bus whose publishers can take the ids that ROS expects."""

    @property
    def zid(self) -> str:
        """The session's id in hexadecimal digits."""

    def name_publisher(self, key: str, gid: bytes) -> None:
        """Publish a key under this id from now on."""


class RosBridge:
    """One node ``steerd_<car>`` with a publisher for each topic that the car sends."""

    def __init__(self, bus: RosBus, car: str, domain: int) -> None:
        """Declare node and publishers.

        Raises:
            BusError: the bus is closed.
            ValueError: the domain is invalid.
        """
        self._bus = bus
        node = f"steerd_{car}"
        sent: dict[str, type[Any]] = {
            topic.name: topic.message
            for topic in TOPICS
            if topic.on_bus and topic.direction is Direction.OUT
        }
        sent[DRIVE_NAME] = AckermannDriveStamped
        self._tokens: list[Token] = [bus.declare_alive(make_node_token(domain, bus.zid, node))]
        self._keys: dict[str, str] = {}
        for entity, (name, cls) in enumerate(sent.items(), _FIRST_ENTITY):
            topic = make_key(car, name)
            key = self._keys[name] = make_ros_key(domain, topic, cls)
            token = make_publisher_token(domain, bus.zid, entity, node, topic, cls)
            bus.name_publisher(key, make_gid(token))
            self._tokens.append(bus.declare_alive(token))

    def publish(self, record: PipeRecord) -> None:
        """Publish one record under its ROS key; an actuation also as a drive command."""
        self._put(record.topic.name, record.data)
        if record.topic.name == topics.ACTUATION.name:
            self._put(DRIVE_NAME, encode(make_drive(decode(Actuation, record.data))))

    def _put(self, name: str, data: bytes) -> None:
        key = self._keys.get(name)
        if key is not None:
            with contextlib.suppress(BusError):
                self._bus.publish(key, data)


def make_drive(sent: Actuation) -> AckermannDriveStamped:
    """The command on the wire in F1TENTH's message; rates and accelerations are 0, unset."""
    return AckermannDriveStamped(sent.header, AckermannDrive(sent.steer, 0.0, sent.speed, 0.0, 0.0))
