"""ROS 2 nodes with nothing of ours on the wire: a LiDAR localiser, and a controller on a circle.

ros_peer.py localise MOCAP_URL ENDPOINT TRACK    poses of the simulated mocap, worse and later
ros_peer.py steer ENDPOINT                       from the car's odometry to /drive
"""

import contextlib
import json
import math
import os
import select
import signal
import sys
import time
from collections import deque
from pathlib import Path

import numpy as np
import zenoh  # noqa: TID251

from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.sockets import make_receiver
from tests import ros_messages as ros

NOISE, YAW_NOISE = 0.01, 0.01
"""Of a pose [m, rad], from scan to scan."""
LATENCY = 0.03
"""From scan to message [s]; the stamp is the message's, as with F1TENTH's particle filter."""
COG_AHEAD = 0.17145
"""The simulated body's place before the rear axle [m], whose pose a localiser gives."""
RADIUS, WHEELBASE, SPEED = 2.0, 0.33, 1.0


def connect(endpoint):
    """A session that dials the daemon, as ROS's router does."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("client"))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


class Publisher:
    def __init__(self, session, topic, kind):
        self._put, self._key, self._sent = session.put, ros.make_key(0, topic, kind), 0

    def send(self, data):
        self._sent += 1
        beside = ros.make_attachment(self._sent, time.time_ns(), b"p" * 16)
        self._put(self._key, data, attachment=beside)


def localise(url, endpoint, track):
    """Every other pose as nav_msgs/Odometry; where the car really was goes to a file."""
    receiver, rng = make_receiver(parse_mocap_url(url), IngestConfig()), np.random.default_rng(1)
    waiting, count = deque(), 0
    with connect(endpoint) as session, Path(track).open("w", buffering=1) as file:
        publisher = Publisher(session, "pf/pose/odom", ros.ODOMETRY)
        while True:
            for fd in select.select(receiver.fds(), [], [], 0.002)[0]:
                for pose in receiver.read_ready(fd):
                    count += 1
                    if count % 2 and math.isfinite(pose.x):
                        file.write(f"{pose.x} {pose.y}\n")
                        waiting.append((time.monotonic() + LATENCY, pose))
            while waiting and time.monotonic() >= waiting[0][0]:
                publisher.send(spoil(waiting.popleft()[1], rng))
            receiver.on_timer(time.monotonic_ns())


def spoil(pose, rng):
    """The rear axle's pose as a LiDAR sees it."""
    yaw = pose.yaw + rng.normal(0.0, YAW_NOISE)
    x = pose.x - COG_AHEAD * math.cos(pose.yaw) + rng.normal(0.0, NOISE)
    y = pose.y - COG_AHEAD * math.sin(pose.yaw) + rng.normal(0.0, NOISE)
    turned = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return ros.pack_pose(ros.ODOMETRY, time.time_ns(), (x, y, 0.0), turned, "/map")


def steer(endpoint):
    """Keep the car on the circle to its left."""
    with connect(endpoint) as session:
        heard = session.declare_subscriber(ros.make_key(0, "steerd/car1/odom", ros.ODOMETRY))
        publisher = Publisher(session, "drive", ros.DRIVE)
        for sample in heard:
            pose = ros.STORE.deserialize_cdr(sample.payload.to_bytes(), ros.ODOMETRY).pose.pose
            x, y = pose.position.x, pose.position.y - RADIUS
            yaw = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            turned = math.remainder(yaw - math.atan2(x, -y), 2.0 * math.pi)
            turned += COG_AHEAD / RADIUS  # on a circle the body points out of it
            angle = WHEELBASE / RADIUS + 0.8 * (math.hypot(x, y) - RADIUS) - turned
            publisher.send(ros.pack_drive(angle, SPEED))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # As simulated hardware: a localiser does not wait for this machine's other programs.
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
    {"localise": localise, "steer": steer}[sys.argv[1]](*sys.argv[2:])
