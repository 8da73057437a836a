"""Poses of a ROS 2 node: a localiser's, for labs without motion capture.

`nav_msgs/Odometry`, `geometry_msgs/PoseWithCovarianceStamped` and `geometry_msgs/PoseStamped` in
CDR, as rmw_zenoh sends them. Which one it is follows from its length: a decoder takes only what it
reads to the end. Axes and units are ROS's (z up, x forward, metres).
"""

from math import isfinite
from typing import Any

from steerd.mocap_link.source import Pose
from steerd.mocap_link.zenoh_pose import PoseError
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.standard import Odometry, PoseStamped, PoseWithCovarianceStamped

_KINDS: tuple[type[Any], ...] = (PoseStamped, PoseWithCovarianceStamped, Odometry)


def decode_ros_pose(payload: bytes, t_arrival_ns: int) -> Pose:
    """Decode one message; its stamp is the time at which the car was there, on the node's clock.

    Raises:
        PoseError: it is none of the three, or its numbers are no pose.
    """
    for kind in _KINDS:
        try:
            message: Any = decode(kind, payload)
        except CodecError:
            continue
        pose = message.pose if kind is PoseStamped else message.pose.pose
        p, q, stamp = pose.position, pose.orientation, message.header.stamp
        numbers = (p.x, p.y, p.z, q.w, q.x, q.y, q.z)
        if not all(map(isfinite, numbers)) or stamp.sec < 0:
            raise PoseError(f"{kind.__name__} with numbers that are no pose")
        ticks = stamp.sec * 1_000_000_000 + stamp.nanosec
        body = message.header.frame_id
        return Pose(body, None, ticks or None, None, t_arrival_ns, numbers[:3], numbers[3:])
    names = ", ".join(kind.__name__ for kind in _KINDS)
    raise PoseError(f"{len(payload)} bytes that are none of {names}")
