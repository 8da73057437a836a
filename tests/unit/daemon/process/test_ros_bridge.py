"""The bridge into ROS's graph, on a bus that records what is published."""

import struct
from math import cos, nan, pi, sin

import pytest

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.process.gateway import RosBridge
from steerd.daemon.process.views import PERIOD_NS, Views, make_odometry, make_vesc_state
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.bus import BusError
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.ros_keys import make_gid, make_ros_key
from steerd.steer_bus.standard import AckermannDriveStamped, Odometry
from tests.blank import blank
from tests.local_bus import LocalBus, LocalHub


class NamedBus(LocalBus):
    """A local bus that has an id and remembers its publishers' ids."""

    zid = "ab12"

    def __init__(self, hub):
        super().__init__(hub)
        self.gids = {}

    def name_publisher(self, key, gid):
        self.gids[key] = gid


@pytest.fixture
def bus():
    return NamedBus(LocalHub())


def test_each_publisher_has_a_token_whose_hash_it_sends(bus):
    RosBridge(bus, "car1", 5)
    tokens = bus.alive("@ros2_lv/5/ab12/**")
    publishers = {t for t in tokens if "/MP/" in t}
    assert len(tokens - publishers) == 1  # the node
    assert {make_gid(token) for token in publishers} == set(bus.gids.values())
    assert len(bus.gids) == len(publishers)
    assert not [key for key in bus.gids if "/cmd/" in key or "/in/" in key]


def test_a_record_goes_out_once_and_unchanged(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/**", 8)
    data = encode(m.ClockSample(m.make_header(1, m.BODY), 2, 3, 4))
    bridge.publish(PipeRecord(topics.CLOCK, 0, 0, 0, data))
    (sample,) = heard.poll()
    assert (sample.key, sample.data) == (
        make_ros_key(0, "steerd/car1/clock", m.ClockSample), data,
    )  # fmt: skip


def test_what_went_to_the_wire_goes_out_as_a_drive_command_too(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/steerd/car1/drive/**", 8)
    sent = m.Actuation(m.make_header(7, m.BODY), 1, m.ActuationMode.SPEED, 0.25, 1.5, 0.0, b"\2")
    bridge.publish(PipeRecord(topics.ACTUATION, 0, 0, 0, encode(sent)))
    (sample,) = heard.poll()
    drive = decode(AckermannDriveStamped, sample.data)
    assert (drive.header, drive.drive.steering_angle, drive.drive.speed) == (sent.header, 0.25, 1.5)
    assert sample.data[-20:] == struct.pack("<5f", 0.25, 0.0, 1.5, 0.0, 0.0)


def test_what_is_not_the_cars_to_send_stays(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/**", 8)
    bridge.publish(PipeRecord(topics.OPERATOR, 0, 0, 0, b""))
    assert heard.poll() == []


def test_a_closed_bus_stops_no_gateway(bus):
    bridge = RosBridge(bus, "car1", 0)
    bus.close()
    data = encode(m.ClockSample(m.make_header(1, m.BODY), 2, 3, 4))
    bridge.publish(PipeRecord(topics.CLOCK, 0, 0, 0, data))
    with pytest.raises(BusError):
        bus.publish("a", data)


# Standard ROS messages: made from the car's own, at most 50 of each kind per second.


def test_odometry_has_the_pose_and_the_velocity_in_the_body_frame():
    state = blank(
        m.StateMessage,
        x=1.0,
        y=2.0,
        yaw=pi / 2,
        speed=2.0,
        slip_angle=0.1,
        yaw_rate=0.5,
        yaw_sd=0.2,
    )
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
    state = blank(m.StateMessage, x=3.0)
    for k in range(10):
        t_ns = k * PERIOD_NS // 4
        made += views.convert(PipeRecord(topics.STATE, k, t_ns, t_ns, encode(state)))
    assert [record.log_time_ns for record in made] == [0, PERIOD_NS, 2 * PERIOD_NS]
    assert [record.sequence for record in made] == [0, 1, 2]
    assert {record.topic for record in made} == {topics.ODOM}
    assert decode(Odometry, made[0].data).pose.pose.position.x == 3.0


def test_other_records_have_no_view():
    record = PipeRecord(topics.TICK, 0, 0, 0, b"")
    assert list(Views().convert(record)) == []
