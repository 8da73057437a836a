"""Bring your own motion capture: put poses on the bus that `--mocap zenoh:KEY` listens to.

    steerd run --port … --mocap zenoh:lab/poses/car
    python publish_poses.py natnet://HOST/BODY --key lab/poses/car

Reads a NatNet or VRPN server here, as an example of a source, and publishes each pose as one JSON
object: position and quaternion in the source's own units and axes, and the time at which the pose
was true on this machine's clock, in nanoseconds from anywhere.
"""

import argparse
import select
import signal
import sys
from dataclasses import replace

from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.sockets import make_receiver
from steerd.mocap_link.source import Pose
from steerd.mocap_link.zenoh_pose import encode_pose
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus


def make_payload(pose: Pose) -> bytes:
    """The pose as it came, stamped with its time of validity here."""
    return encode_pose(replace(pose, source_ticks=pose.t_valid_ns))


def main() -> int:
    """Publish until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", help="natnet://HOST[:PORT]/BODY or vrpn://HOST[:PORT]/BODY")
    parser.add_argument("--key", required=True, help="where `steerd run --mocap zenoh:KEY` listens")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="the daemon's endpoint")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    clock = MonotonicClock()
    receiver = make_receiver(parse_mocap_url(args.source), IngestConfig())
    with ZenohBus(Profile(hub=False, endpoint=args.connect)) as bus:
        try:
            while True:
                for fd in select.select(receiver.fds(), [], [], 0.01)[0]:
                    for pose in receiver.read_ready(fd):
                        bus.publish(args.key, make_payload(pose))
                receiver.on_timer(clock.now_ns())
        except KeyboardInterrupt:
            receiver.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
