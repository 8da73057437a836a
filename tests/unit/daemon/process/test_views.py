"""Standard ROS messages: made from the car's own, at most 50 of each kind per second."""

from math import cos, nan, pi, sin

import pytest

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.process.views import PERIOD_NS, Views, make_odometry, make_vesc_state
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.standard import Odometry
from tests.blank import blank


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
