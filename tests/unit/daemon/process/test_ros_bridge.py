"""ROS's graph: the car's bridge into it, and a node's /drive, on a bus inside the process."""

import struct
from math import cos, isnan, nan, pi, sin
from types import SimpleNamespace

import pytest

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.lease import VALID_MS, Lease, Remote, take_command, valid_command
from steerd.daemon.process.gateway import RosBridge, RosDrive, find_pose_key
from steerd.daemon.process.views import PERIOD_NS, Views, make_odometry, make_vesc_state
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.standard import AckermannDriveStamped, Odometry
from steerd.steer_bus.topics import BusError, Sample, make_gid
from tests.blank import blank
from tests.local_bus import LocalBus, LocalHub
from tests.ros_messages import DRIVE, ODOMETRY, make_key, pack_drive

BOOT, MS = 815, 1_000_000


@pytest.fixture
def bus():
    """A local bus that has an id and remembers its publishers' ids."""
    bus = LocalBus(LocalHub())
    bus.zid, bus.gids = "ab12", {}
    bus.name_publisher = bus.gids.__setitem__
    return bus


def test_each_publisher_has_a_token_whose_hash_it_sends(bus):
    RosBridge(bus, "car1", 5)
    tokens = bus.alive("@ros2_lv/5/ab12/**")
    publishers = {t for t in tokens if "/MP/" in t}
    assert len(tokens - publishers) == 1  # the node
    assert {make_gid(token) for token in publishers} == set(bus.gids.values())
    assert len(bus.gids) == len(publishers)
    assert not [key for key in bus.gids if "/cmd/" in key or "/in/" in key]


def test_what_went_to_the_wire_goes_out_as_a_drive_command_too(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/steerd/car1/drive/**", 8)
    sent = m.Actuation(m.make_header(7, m.BODY), 1, m.ActuationMode.SPEED, 0.25, 1.5, 0.0, b"\2")
    bridge.publish(PipeRecord(topics.ACTUATION, 0, 0, 0, encode(sent)))
    (sample,) = heard.poll()
    drive = decode(AckermannDriveStamped, sample.data)
    assert (drive.header, drive.drive.steering_angle, drive.drive.speed) == (sent.header, 0.25, 1.5)
    assert sample.data[-20:] == struct.pack("<5f", 0.25, 0.0, 1.5, 0.0, 0.0)


def test_what_is_not_the_cars_to_send_stays_and_a_closed_bus_stops_no_gateway(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/**", 8)
    bridge.publish(PipeRecord(topics.OPERATOR, 0, 0, 0, b""))
    assert heard.poll() == []
    bus.close()
    data = encode(m.ClockSample(m.make_header(1, m.BODY), 2, 3, 4))
    bridge.publish(PipeRecord(topics.CLOCK, 0, 0, 0, data))
    with pytest.raises(BusError):
        bus.publish("a", data)


@pytest.mark.parametrize("hash_of_type", [None, "TypeHashNotSupported"])
def test_a_nodes_drive_is_a_controllers_command(bus, hash_of_type):
    drive = RosDrive(bus, 3, BOOT)
    bus.publish(make_key(3, "drive", DRIVE, hash_of_type), pack_drive(0.25, 2.0, 7_000_000_009))
    bus.publish(make_key(4, "drive", DRIVE), pack_drive(0.1, 1.0))
    bus.publish(make_key(3, "car2/drive", DRIVE), pack_drive(0.1, 1.0))
    bus.publish(make_key(3, "drive", ODOMETRY), pack_drive(0.1, 1.0))
    (command,) = drive.take()
    assert (command.boot_id, command.valid_ms) == (BOOT, VALID_MS)
    assert (command.steer, command.speed, m.stamp_ns(command.header)) == (0.25, 2.0, 7_000_000_009)
    assert list(drive.take()) == []


def test_a_second_node_is_refused_while_the_first_drives():
    hub = LocalHub()
    drive, nodes = RosDrive(LocalBus(hub), 0, BOOT), (LocalBus(hub), LocalBus(hub))
    remote = Remote(Lease(BOOT))
    for t_ms, node, taken in ((0, 0, True), (20, 1, False), (40, 0, True), (1041, 1, True)):
        nodes[node].publish(make_key(0, "drive", DRIVE), pack_drive(0.1 * node, 1.0))
        (command,) = drive.take()
        remote = take_command(remote, command, t_ms * MS)
        assert (remote.command is command) is taken
    assert valid_command(remote, 1041 * MS) is command


def test_what_is_no_drive_command_displaces_none(bus):
    drive, whole = RosDrive(bus, 0, BOOT), pack_drive(nan, 1.0)
    bus.publish(make_key(0, "drive", DRIVE), whole)
    for size in (*range(len(whole)), *range(len(whole) + 4, 5000, 50)):
        bus.publish(make_key(0, "drive", DRIVE), whole.ljust(size, b"\xff")[:size])
    (command,) = drive.take()
    assert isnan(command.steer), "not finite: the loop brakes"


def test_a_nodes_odd_times_go_into_no_message_that_cannot_be_packed():
    said = [Sample("", pack_drive(0.1, 1.0, -1), -1, -(1 << 63), b"")]
    bus = SimpleNamespace(subscribe=lambda *_: SimpleNamespace(poll=lambda: said))
    (command,) = RosDrive(bus, 0, BOOT).take()
    assert decode(m.DriveCommand, encode(command)).t_source_ns == -(1 << 63)


@pytest.mark.parametrize(("mocap", "key"), [
    ("ros2:///pf/pose/odom", "3/pf/pose/odom/*/*"), ("zenoh:lab/pose", "lab/pose"),
    ("natnet://10.0.0.1/car", None), ("ros2://pf", None), (None, None),
])  # fmt: skip
def test_poses_are_listened_for_where_the_address_says(mocap, key):
    assert find_pose_key(RunOptions("", mocap=mocap, ros_domain=3)) == key


# Standard ROS messages: made from the car's own, at most 50 of each kind per second.
def test_odometry_has_the_pose_and_the_velocity_in_the_body_frame():
    moving = {"speed": 2.0, "slip_angle": 0.1, "yaw_rate": 0.5, "yaw_sd": 0.2}
    state = blank(m.StateMessage, x=1.0, y=2.0, yaw=pi / 2, **moving)
    made = make_odometry(state)
    pose, twist = made.pose.pose, made.twist.twist
    assert (pose.position.x, pose.position.y) == (1.0, 2.0)
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((sin(pi / 4), cos(pi / 4)))
    assert (twist.linear.x, twist.linear.y) == pytest.approx((2.0 * cos(0.1), 2.0 * sin(0.1)))
    assert twist.angular.z == 0.5
    assert made.pose.covariance[35] == pytest.approx(0.04)
    assert made.child_frame_id == m.BODY


def test_telemetry_without_a_fault_code_has_none():
    made = make_vesc_state(blank(m.VescTelemetry, erpm=4000, fault_code=-1, temp_fet=nan))
    assert (made.state.speed, made.state.fault_code) == (4000.0, 0)


def test_each_kind_is_made_at_most_every_20_ms():
    views, made = Views(), []
    assert list(views.convert(PipeRecord(topics.TICK, 0, 0, 0, b""))) == []
    state = blank(m.StateMessage, x=3.0)
    for k in range(10):
        t_ns = k * PERIOD_NS // 4
        made += views.convert(PipeRecord(topics.STATE, k, t_ns, t_ns, encode(state)))
    assert [record.log_time_ns for record in made] == [0, PERIOD_NS, 2 * PERIOD_NS]
    assert [record.sequence for record in made] == [0, 1, 2]
    assert {record.topic for record in made} == {topics.ODOM}
    assert decode(Odometry, made[0].data).pose.pose.position.x == 3.0
