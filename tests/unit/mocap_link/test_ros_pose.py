"""Poses of ROS 2 nodes, made by the serialiser of rosbags."""

import re
from math import pi, sqrt

import pytest

from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.zenoh_pose import decode_ros_pose, make_bus_source
from tests.ros_messages import ODOMETRY, POSE, UNSURE_POSE, pack_pose

KINDS = (POSE, UNSURE_POSE, ODOMETRY)
PLACE, LEFT, STAMP_NS = (
    (1.5, -2.0, 0.1), (sqrt(0.5), 0.0, 0.0, sqrt(0.5)), 1_700_000_000_000_000_250,
)  # fmt: skip
URL = parse_mocap_url("ros2:///pf/pose/odom")


def pose_of(kind=ODOMETRY, stamp_ns=STAMP_NS, frame="map"):
    """A message at `PLACE`, turned left by 90 degrees."""
    return pack_pose(kind, stamp_ns, PLACE, LEFT, frame)


@pytest.fixture
def source():
    """The pipeline of a car file for millimetres and y up, which ROS is not."""
    frame = FrameConfig(units="mm", up="y", marker_rear_x=0.0, cog_ahead_of_rear=0.17)
    return make_bus_source(URL, IngestConfig(frame))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frame", ["", "map", "/map", "odom_of_car"])
def test_each_kind_is_known_by_itself(kind, frame):
    pose = decode_ros_pose(pose_of(kind, frame=frame), 7)
    assert (pose.position, pose.quaternion, pose.body) == (PLACE, LEFT, frame)
    assert (pose.source_ticks, pose.t_arrival_ns) == (STAMP_NS, 7)


def test_a_pose_is_placed_in_metres_with_z_up_and_another_frames_is_none(source):
    pose = source.on_message(pose_of(), 7)
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((1.5, -2.0 + 0.17, pi / 2))
    assert (pose.height, pose.tilt, pose.rejected) == (pytest.approx(0.1), 0.0, None)
    assert source.on_message(pose_of(frame="odom"), 8) is None
    assert source.status().detail == "a pose of 'odom', those before were of 'map'"


@pytest.mark.parametrize("kind", KINDS)
def test_bytes_of_any_other_length_are_one_line_and_no_pose(kind, source):
    whole = pose_of(kind)
    cut = [whole[:size] for size in range(len(whole))]
    for data in (*cut, *(whole + bytes(size) for size in range(4, 64))):
        pose = source.on_message(data, 0)
        if pose is None:
            assert re.fullmatch(r"\d+ bytes that are not an Odometry, .+", source.status().detail)
        else:  # what is cut behind its pose is a PoseStamped; one in front of it is no place
            assert pose.rejected or pose.position == PLACE
    assert source.on_message(whole, 0).rejected is None


@pytest.mark.parametrize("stamp_ns", [0, -1_000_000_000])
def test_a_stamp_that_is_none_leaves_the_time_of_arrival(stamp_ns, source):
    assert source.on_message(pose_of(stamp_ns=stamp_ns), 7).t_valid_ns == 7
