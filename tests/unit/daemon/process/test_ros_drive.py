"""A ROS 2 node's `/drive`, serialised by rosbags, as an external controller."""

from dataclasses import replace

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.external_controller import VALID_MS
from steerd.daemon.process.ros_drive import RosDrive
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import decode
from tests.local_bus import LocalBus, LocalHub

BOOT, MS = 11, 1_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)
FIELDS = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
STORE.register(get_types_from_msg(
    "".join(f"float32 {name}\n" for name in FIELDS), "ackermann_msgs/msg/AckermannDrive"
))  # fmt: skip
KIND = "ackermann_msgs/msg/AckermannDriveStamped"
STORE.register(get_types_from_msg("std_msgs/Header header\nAckermannDrive drive\n", KIND))
KEY = "0/drive/ackermann_msgs::msg::dds_::AckermannDriveStamped_/RIHS01_00"
STATE = m.StateMessage(
    m.make_header(5, m.BODY), 0, 1, 0, SupervisorState.RUNNING, *[0.0] * 19, 1.0, 0.0
)


def command(steer: float, speed: float) -> bytes:
    """The node's message."""
    t = STORE.types
    header = t["std_msgs/msg/Header"](t["builtin_interfaces/msg/Time"](1, 2), "base_link")
    drive = t["ackermann_msgs/msg/AckermannDrive"](steer, 0.0, speed, 0.0, 0.0)
    return bytes(STORE.serialize_cdr(t[KIND](header, drive), KIND))


@pytest.fixture
def node():
    """The bus of the node, and what answers for it in the gateway."""
    hub = LocalHub()
    return LocalBus(hub), RosDrive(LocalBus(hub), None, BOOT)


def answered(drive: RosDrive, t_ms: int, **given) -> m.DriveCommand | None:
    data = drive.answer(replace(STATE, mono_ns=t_ms * MS, **given))
    return None if data is None else decode(m.DriveCommand, data)


def test_commands_are_repeated_while_they_are_good(node) -> None:
    bus, drive = node
    assert answered(drive, 0) is None
    bus.publish(KEY, command(0.25, 2.0))
    first, later = answered(drive, 10), answered(drive, 10 + VALID_MS)
    assert (first.steer, first.speed, first.boot_id) == (0.25, 2.0, BOOT)
    assert (later.steer, later.lease_id) == (0.25, first.lease_id)
    assert later.seq > first.seq
    assert answered(drive, 11 + VALID_MS) is None, "the node is silent"


def test_it_comes_to_its_stop_no_faster_than_the_daemon(node) -> None:
    bus, drive = node
    bus.publish(KEY, command(0.1, 3.0))
    stopping = answered(drive, 10, mode=SupervisorState.STOPPING, speed_ref=0.4)
    assert (stopping.steer, stopping.speed) == (pytest.approx(0.1), pytest.approx(0.4))


@pytest.mark.parametrize("junk", [b"", b"\0\1\0\0", command(0.1, 1.0)[:-3], bytes(64)])
def test_what_is_no_command_is_not_one(node, junk: bytes) -> None:
    bus, drive = node
    bus.publish(KEY, junk)
    assert answered(drive, 10) is None
