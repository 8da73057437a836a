"""Messages, keys and attachments of ROS 2 nodes on rmw_zenoh: rosbags packs, nothing is ours."""

import struct

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
UNSURE_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DRIVE = "ackermann_msgs/msg/AckermannDriveStamped"
_FIELDS = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(get_types_from_msg(
    "".join(f"float32 {name}\n" for name in _FIELDS), "ackermann_msgs/msg/AckermannDrive"
))  # fmt: skip
STORE.register(get_types_from_msg("std_msgs/Header header\nAckermannDrive drive\n", DRIVE))
_OF = {name.rpartition("/")[2]: made for name, made in STORE.types.items()}


def pack_pose(kind, stamp_ns, position, quaternion, frame="map") -> bytes:
    """A pose as one of the three kinds; position [m], quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    pose = _OF["Pose"](_OF["Point"](*position), _OF["Quaternion"](x, y, z, w))
    unsure, still = _OF["PoseWithCovariance"](pose, np.zeros(36)), _OF["Vector3"](0.0, 0.0, 0.0)
    twist = _OF["TwistWithCovariance"](_OF["Twist"](still, still), np.zeros(36))
    parts = {POSE: (pose,), UNSURE_POSE: (unsure,), ODOMETRY: ("base_link", unsure, twist)}
    return _pack(kind, stamp_ns, frame, *parts[kind])


def pack_drive(steer, speed, stamp_ns=0) -> bytes:
    """A node's drive command [rad, m/s]."""
    return _pack(DRIVE, stamp_ns, "", _OF["AckermannDrive"](steer, 0.0, speed, 0.0, 0.0))


def _pack(kind, stamp_ns, frame, *parts) -> bytes:
    header = _OF["Header"](_OF["Time"](*divmod(stamp_ns, 10**9)), frame)
    return bytes(STORE.serialize_cdr(STORE.types[kind](header, *parts), kind))


def make_key(domain, topic, kind, hash_of_type=None) -> str:
    """Where rmw_zenoh publishes messages of a kind."""
    package, _, name = kind.split("/")
    of_type = STORE.hash_rihs01(kind) if hash_of_type is None else hash_of_type
    return f"{domain}/{topic}/{package}::msg::dds_::{name}_/{of_type}"


def make_attachment(sequence, sent_ns, gid) -> bytes:
    """What rmw_zenoh sends beside each message."""
    return struct.pack("<qqB16s", sequence, sent_ns, 16, gid)
