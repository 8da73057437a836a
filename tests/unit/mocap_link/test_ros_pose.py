"""Poses of ROS 2 nodes, made by the serialiser of rosbags."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.zenoh_pose import PoseError, decode_ros_pose, make_bus_source

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types


def make(kind: str, x: float = 1.5, sec: int = 1700000000) -> bytes:
    """A message at (x, -2), turned by 90 degrees."""
    of = {name.rpartition("/")[2]: TYPES[name] for name in TYPES}
    header = of["Header"](of["Time"](sec, 250), "map")
    half = np.sqrt(0.5)
    pose = of["Pose"](of["Point"](x, -2.0, 0.1), of["Quaternion"](0.0, 0.0, half, half))
    unsure = of["PoseWithCovariance"](pose, np.zeros(36))
    zero = of["Vector3"](0.0, 0.0, 0.0)
    twist = of["TwistWithCovariance"](of["Twist"](zero, zero), np.zeros(36))
    fields = {
        "geometry_msgs/msg/PoseStamped": (header, pose),
        "geometry_msgs/msg/PoseWithCovarianceStamped": (header, unsure),
        "nav_msgs/msg/Odometry": (header, "base_link", unsure, twist),
    }
    return bytes(STORE.serialize_cdr(TYPES[kind](*fields[kind]), kind))


KINDS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_known_by_itself(kind: str) -> None:
    pose = decode_ros_pose(make(kind), 7)
    assert pose.position == (1.5, -2.0, 0.1)
    assert pose.quaternion == pytest.approx((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))
    assert (pose.source_ticks, pose.t_arrival_ns) == (1_700_000_000_000_000_250, 7)
    assert pose.body == "map"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", [lambda b: b[:-4], lambda b: b + bytes(8), lambda b: b[:20]])
def test_what_is_cut_or_too_long_is_no_pose(kind: str, change) -> None:
    with pytest.raises(PoseError):
        decode_ros_pose(change(make(kind)), 0)


@pytest.mark.parametrize("bad", [{"x": np.nan}, {"x": np.inf}, {"sec": -1}])
def test_numbers_that_are_no_pose_are_refused(bad) -> None:
    with pytest.raises(PoseError, match="NaN"):
        decode_ros_pose(make("nav_msgs/msg/Odometry", **bad), 0)


@pytest.mark.parametrize(("query", "domain"), [("", 0), ("?domain=3", 3)])
def test_the_address_names_the_topic_of_one_domain(query: str, domain: int) -> None:
    url = parse_mocap_url("ros2:///pf/pose/odom" + query)
    assert (url.scheme, url.key, url.up) == ("ros2", f"{domain}/pf/pose/odom/*/*", "z")


@pytest.mark.parametrize(
    "text", ["ros2:/pf", "ros2://host/pf", "ros2:///", "ros2:///a//b", "ros2:///a/*"]
)
def test_an_address_without_a_topic_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="ros2:///pf/pose/odom"):
        parse_mocap_url(text)


def test_a_topic_that_changes_its_type_or_frame_gives_no_poses() -> None:
    source = make_bus_source(parse_mocap_url("ros2:///pf/pose/odom"), IngestConfig())
    data = make("nav_msgs/msg/Odometry")
    assert source.on_message(data, 7) is not None
    assert source.on_message(data.replace(b"map\0", b"odo\0", 1), 8) is None
    assert "pose in frame 'odo', those before were in 'map'" in source.status().detail
    assert source.on_message(b"\0\1\0\0" + bytes(40), 9) is None
    assert "right topic?" in source.status().detail
    assert source.status().counts["malformed"] == 2


def test_a_quaternion_off_length_1_is_refused() -> None:
    source = make_bus_source(parse_mocap_url("ros2:///pf/pose/odom"), IngestConfig())
    half = np.sqrt(0.5).tobytes()
    pose = source.on_message(make(KINDS[0]).replace(half, np.float64(0.9).tobytes()), 7)
    assert pose is not None
    assert pose.rejected == "quaternion"
