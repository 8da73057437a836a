"""The gateway between a core's pipe and a bus, heartbeats through both and back; ROS's graph."""

import os
import socket
import struct
from contextlib import suppress
from dataclasses import replace
from math import cos, isnan, nan, pi, sin
from types import SimpleNamespace

import pytest

from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord, pack_record
from steerd.daemon.ipc.requests import REQUEST_MAX, make_badge, unpack_request
from steerd.daemon.loop.lease import VALID_MS, Lease, Remote, take_command, valid_command
from steerd.daemon.process.gateway import Gateway, RosBridge, RosDrive, find_pose_key, run_gateway
from steerd.daemon.process.guard import BEAT_NS, RemotePath
from steerd.daemon.process.views import PERIOD_NS, Views, make_odometry, make_vesc_state
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.standard import AckermannDriveStamped, Odometry
from steerd.steer_bus.topics import BusError, Sample, make_gid, make_key
from tests.blank import blank
from tests.local_bus import LocalBus, LocalHub
from tests.ros_messages import DRIVE, ODOMETRY, pack_drive
from tests.ros_messages import make_key as make_ros_key

POSE_KEY = "lab/pose"
TICK = encode(m.Tick(m.make_header(1, m.BODY), 1, 2, 3, 4, 0))

hub = pytest.fixture(lambda: LocalHub())
gateway = pytest.fixture(lambda hub: Gateway(LocalBus(hub), "car1", POSE_KEY))
other = pytest.fixture(lambda hub: LocalBus(hub))  # somebody else on the bus


def packets(core):
    """What has arrived at the core."""
    found = []
    with suppress(BlockingIOError):
        while True:
            found.append(unpack_request(core.recv(2 * REQUEST_MAX)))
    return found


@pytest.fixture
def arriving(gateway, ends):
    """Forwards what the bus holds; gives what arrives at the core."""

    def forward():
        gateway.forward_requests(ends[0])
        return packets(ends[1])

    return forward


def requests(arrived):
    return [decode(m.OperatorRequest, data) for _, data in arrived]


@pytest.mark.usefixtures("gateway")
def test_it_is_alive_and_gives_the_schemas(other):
    assert other.alive("**") == {"steerd/car1/alive"}
    (text,) = other.query(make_key("car1", "schema/steerd_msgs/msg/Tick")).values()
    assert b"due_ns" in text


def test_what_comes_from_the_bus_is_not_sent_back_to_it(gateway, other):
    heard = other.subscribe(make_key("car1", topics.OPERATOR), 8)
    gateway.publish([PipeRecord(topics.OPERATOR, 0, 0, 0, ask(ARM))])
    assert heard.poll() == []


def ask(kind, seq=1, lease_id=7, operator="ada"):
    """An operator's request, encoded."""
    header = m.make_header(1, m.BODY)
    return encode(m.OperatorRequest(header, 5, lease_id, seq, int(kind), operator))


ARM, STOP, ESTOP, ALIVE = (m.RequestKind[k] for k in ("ARM", "STOP", "ESTOP", "KEEPALIVE"))


def test_requests_and_poses_go_to_the_core_stops_first(other, arriving):
    drive = encode(m.DriveCommand(m.make_header(1, m.BODY), 5, 0, 1, 2, 100, 0.1, 1.0))
    other.publish(make_key("car1", topics.OPERATOR), ask(ARM, lease_id=0))
    other.publish(make_key("car1", topics.DRIVE), drive)
    other.publish(make_key("car2", topics.DRIVE), drive)
    other.publish(make_key("car1", topics.STOP), ask(ESTOP, lease_id=0))
    other.publish(POSE_KEY, b"pose")
    assert arriving() == [
        (topics.OPERATOR.name, ask(ESTOP, lease_id=0)),
        (topics.OPERATOR.name, ask(ARM, lease_id=0)),
        (topics.DRIVE.name, drive),
        (topics.EXTERNAL_POSE.name, b"pose"),
    ]


@pytest.mark.parametrize("topic", [topics.STOP, topics.OPERATOR])
def test_what_does_not_decode_displaces_no_request(other, arriving, topic):
    other.publish(make_key("car1", topic), ask(STOP))
    for size in (0, 1, 40, 200, REQUEST_MAX + 1) * 200:
        other.publish(make_key("car1", topic), bytes([size % 251]) * size)
    assert [request.kind for request in requests(arriving())] == [STOP]


def test_no_other_request_displaces_a_stop(other, arriving):
    other.publish(make_key("car1", topics.STOP), ask(ESTOP))
    for seq in range(1000):
        other.publish(make_key("car1", topics.OPERATOR), ask(ALIVE, seq))
        other.publish(make_key("car1", topics.STOP), ask(ALIVE, seq))
    assert requests(arriving())[0].kind == ESTOP
    assert arriving() == []


def test_a_lease_is_known_by_a_badge_that_opens_nothing(other, arriving):
    """Whoever sends under the name that the car publishes is another."""
    for lease_id in (7, 7, 8, 0):
        other.publish(make_key("car1", topics.OPERATOR), ask(ALIVE, lease_id=lease_id))
    known = [request.lease_id for request in requests(arriving())]
    assert known[0] == known[1] == make_badge("", 7)
    assert len({*known, 7, 8}) == 5
    assert known[3] == 0, "nobody stays nobody"
    other.publish(make_key("car1", topics.OPERATOR), ask(ALIVE, lease_id=known[0]))
    (request,) = requests(arriving())
    assert request.lease_id not in known


def test_in_a_lab_the_certificate_names_the_operator_and_the_lease(hub, arriving):
    desk, tablet = (LocalBus(hub, who=name) for name in ("desk", "tablet"))
    for bus in (desk, tablet):
        bus.publish(make_key("car1", topics.OPERATOR, bus.who), ask(ALIVE, operator="desk"))
    got = requests(arriving())
    assert [request.operator for request in got] == ["desk", "tablet"]
    assert got[0].lease_id != got[1].lease_id, "one secret, two people"


def test_a_core_that_does_not_read_costs_requests_and_never_blocks(gateway, other, ends):
    ours, core = ends
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    sent = 64
    for seq in range(sent):
        request = ask(ALIVE, seq, operator="x" * (REQUEST_MAX - 100))
        other.publish(make_key("car1", topics.OPERATOR), request)
        gateway.forward_requests(ours)
    assert 0 < len(packets(core)) < sent


def test_it_ends_when_the_pipe_closes_after_all_is_published(gateway, other, ends, pipe):
    heard = other.subscribe(make_key("car1", topics.TICK), 8)
    read_fd, write_fd = pipe
    os.write(write_fd, pack_record(PipeRecord(topics.TICK, 0, 0, 0, TICK)))
    os.close(write_fd)
    run_gateway(gateway, PipeReader(read_fd), ends[0], PipeReader(None))
    assert [sample.data for sample in heard.poll()] == [TICK]


# Heartbeats to the bus and back: who must answer, how soon, and what does not count.
BOOT_ID, HOLDER, MS, LIMIT_S = 815, 42, 1_000_000, 1.0


def beat_at(path: RemotePath, t_ns: int, lease_id: int = 0):
    return replace(path.make_beat(t_ns, 0), lease_id=lease_id)


def test_heartbeats_leave_twenty_times_a_second_and_a_gateway_that_gives_none_back_is_found():
    path = RemotePath(BOOT_ID)
    sent = [t for t in range(0, 1000 * MS, 10 * MS) if path.make_beat(t, 0) is not None]
    assert sent == list(range(0, 1000 * MS, BEAT_NS))
    for t_ms, silent in ((1000, False), (1001, True), (60_000, True)):
        assert path.is_silent(False, LIMIT_S, t_ms * MS) is silent


def test_the_newest_heartbeat_counts_from_when_it_left():
    path = RemotePath(BOOT_ID)
    for t_ms in range(50, 2000, 50):
        beat = beat_at(path, t_ms * MS)
        path.take(encode(beat), (t_ms + 30) * MS)
        path.take(encode(replace(beat, mono_ns=5)), (t_ms + 31) * MS)
        assert not path.is_silent(False, LIMIT_S, (t_ms + 40) * MS)
    assert not path.is_silent(False, LIMIT_S, 2950 * MS)
    assert path.is_silent(False, LIMIT_S, 2951 * MS)


def test_whoever_takes_the_lease_over_the_bus_has_to_answer_and_has_time_for_it():
    path = RemotePath(BOOT_ID, HOLDER)
    assert not path.is_silent(True, LIMIT_S, 5000 * MS)
    for t_ms in range(5050, 6050, 50):
        path.take(encode(beat_at(path, t_ms * MS)), t_ms * MS)  # the gateway's answers
        assert not path.is_silent(True, LIMIT_S, t_ms * MS)
    assert path.is_silent(True, LIMIT_S, 6001 * MS)
    path.take(encode(beat_at(path, 6050 * MS, HOLDER)), 6080 * MS)
    assert not path.is_silent(True, LIMIT_S, 7050 * MS)
    assert path.is_silent(True, LIMIT_S, 7051 * MS)
    assert not path.is_silent(False, LIMIT_S, 7052 * MS), "a lease that has run out is W25's"


@pytest.mark.parametrize("wrong", [
    {"boot_id": 1}, {"lease_id": 7}, {"mono_ns": 500 * MS + 1}, {"mono_ns": -5},
    b"", b"\0" * 7, b"\xff" * 300,
])  # fmt: skip
def test_garbage_another_runs_heartbeat_or_one_from_the_future_is_none(wrong):
    path = RemotePath(BOOT_ID)
    beat = beat_at(path, 500 * MS)
    path.take(wrong if isinstance(wrong, bytes) else encode(replace(beat, **wrong)), 500 * MS)
    assert path.is_silent(False, LIMIT_S, 1002 * MS)


# ROS's graph: the car's bridge into it, and a node's /drive, on a bus inside the process.


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
    drive = RosDrive(bus, 3, BOOT_ID)
    bus.publish(make_ros_key(3, "drive", DRIVE, hash_of_type), pack_drive(0.25, 2.0, 7_000_000_009))
    bus.publish(make_ros_key(4, "drive", DRIVE), pack_drive(0.1, 1.0))
    bus.publish(make_ros_key(3, "car2/drive", DRIVE), pack_drive(0.1, 1.0))
    bus.publish(make_ros_key(3, "drive", ODOMETRY), pack_drive(0.1, 1.0))
    (command,) = drive.take()
    assert (command.boot_id, command.valid_ms) == (BOOT_ID, VALID_MS)
    assert (command.steer, command.speed, m.stamp_ns(command.header)) == (0.25, 2.0, 7_000_000_009)
    assert list(drive.take()) == []


def test_a_second_node_is_refused_while_the_first_drives():
    hub = LocalHub()
    drive, nodes = RosDrive(LocalBus(hub), 0, BOOT_ID), (LocalBus(hub), LocalBus(hub))
    remote = Remote(Lease(BOOT_ID))
    for t_ms, node, taken in ((0, 0, True), (20, 1, False), (40, 0, True), (1041, 1, True)):
        nodes[node].publish(make_ros_key(0, "drive", DRIVE), pack_drive(0.1 * node, 1.0))
        (command,) = drive.take()
        remote = take_command(remote, command, t_ms * MS)
        assert (remote.command is command) is taken
    assert valid_command(remote, 1041 * MS) is command


def test_what_is_no_drive_command_displaces_none(bus):
    drive, whole = RosDrive(bus, 0, BOOT_ID), pack_drive(nan, 1.0)
    bus.publish(make_ros_key(0, "drive", DRIVE), whole)
    for size in (*range(len(whole)), *range(len(whole) + 4, 5000, 50)):
        bus.publish(make_ros_key(0, "drive", DRIVE), whole.ljust(size, b"\xff")[:size])
    (command,) = drive.take()
    assert isnan(command.steer), "not finite: the loop brakes"


def test_a_nodes_odd_times_go_into_no_message_that_cannot_be_packed():
    said = [Sample("", pack_drive(0.1, 1.0, -1), -1, -(1 << 63), b"")]
    bus = SimpleNamespace(subscribe=lambda *_: SimpleNamespace(poll=lambda: said))
    (command,) = RosDrive(bus, 0, BOOT_ID).take()
    assert decode(m.DriveCommand, encode(command)).t_source_ns == -(1 << 63)


@pytest.mark.parametrize(("mocap", "key"), [
    ("ros2:///pf/pose/odom", "3/pf/pose/odom/*/*"), ("zenoh:lab/pose", "lab/pose"),
    ("natnet://10.0.0.1/car", None), ("ros2://pf", None), (None, None),
])  # fmt: skip
def test_poses_are_listened_for_where_the_address_says(mocap, key):
    assert find_pose_key(RunOptions("", mocap=mocap, ros_domain=3)) == key


# Standard ROS messages: made from the car's own, at most 50 of each kind per second.
def test_odometry_has_the_velocity_in_the_body_frame_and_telemetry_may_have_no_fault_code():
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
