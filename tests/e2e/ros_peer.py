"""A ROS 2 localiser and controller with nothing of ours on the wire: rosbags packs, zenoh sends.

Reads the simulated mocap, publishes it as `/pf/pose/odom`, 50 times a second and a little wrong,
and follows a circle of 2 m with `/drive`.
"""

import json
import math
import select
import signal
import struct
import sys
import time

import numpy as np
import zenoh  # noqa: TID251
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.sockets import make_receiver

RADIUS, WHEELBASE, SPEED = 2.0, 0.33, 1.0
NOISE = 0.003
"""Of a position [m]; a good LiDAR localiser errs by some millimetres from scan to scan."""
DRIVE = "ackermann_msgs/msg/AckermannDriveStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
STORE = get_typestore(Stores.ROS2_HUMBLE)
FIELDS = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
STORE.register(get_types_from_msg(
    "".join(f"float32 {name}\n" for name in FIELDS), "ackermann_msgs/msg/AckermannDrive"
))  # fmt: skip
STORE.register(get_types_from_msg("std_msgs/Header header\nAckermannDrive drive\n", DRIVE))
OF = {name.rpartition("/")[2]: made for name, made in STORE.types.items()}


def pack(kind, *values):
    return bytes(STORE.serialize_cdr(STORE.types[kind](*values), kind))


def odometry(header, pose, rng):
    x, y, z = np.array(pose.position) + rng.normal(0.0, NOISE, 3)
    w, i, j, k = pose.quaternion
    placed = OF["Pose"](OF["Point"](x, y, z), OF["Quaternion"](i, j, k, w))
    zero = OF["Vector3"](0.0, 0.0, 0.0)
    twist = OF["TwistWithCovariance"](OF["Twist"](zero, zero), np.zeros(36))
    unsure = OF["PoseWithCovariance"](placed, np.zeros(36))
    return pack(ODOMETRY, header, "base_link", unsure, twist)


def steer(pose):
    """The angle that keeps the car on the circle to its left."""
    off = math.hypot(pose.x, pose.y - RADIUS)
    tangent = math.atan2(pose.x, RADIUS - pose.y)
    turned = math.remainder(pose.yaw - tangent, 2.0 * math.pi)
    return WHEELBASE / RADIUS - 0.8 * (RADIUS - off) - turned


def main(url, endpoint):
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("client"))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    receiver = make_receiver(parse_mocap_url(url), IngestConfig())
    rng, sent = np.random.default_rng(1), 0
    with zenoh.open(config) as session:
        keys = {
            kind: f"0/{topic}/{kind.replace('/', '::').replace('msg::', 'msg::dds_::')}_/"
            f"{STORE.hash_rihs01(kind)}"
            for kind, topic in ((ODOMETRY, "pf/pose/odom"), (DRIVE, "drive"))
        }

        def put(kind, data):
            attachment = struct.pack("<qqB16s", sent, time.time_ns(), 16, bytes(16))
            session.put(keys[kind], data, attachment=attachment)

        while True:
            for fd in select.select(receiver.fds(), [], [], 0.01)[0]:
                for pose in receiver.read_ready(fd):
                    sent += 1
                    if sent % 2 or not math.isfinite(pose.x):
                        continue
                    ago = time.monotonic_ns() - pose.t_valid_ns
                    header = OF["Header"](OF["Time"](*divmod(time.time_ns() - ago, 10**9)), "map")
                    put(ODOMETRY, odometry(header, pose, rng))
                    drive = OF["AckermannDrive"](steer(pose), 0.0, SPEED, 0.0, 0.0)
                    put(DRIVE, pack(DRIVE, header, drive))
            receiver.on_timer(time.monotonic_ns())


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    main(*sys.argv[1:])
