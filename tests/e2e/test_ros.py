"""ROS 2 nodes on rmw_zenoh, with nothing of ours: they see the car, and say where it is."""

import re
import signal
import struct
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import xxhash  # noqa: TID251
import zenoh  # noqa: TID251

from steerd.car_model.car_file import default_car_path
from steerd.steer_bus import messages as m
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import changes, replays
from tests.e2e.ros_peer import LATENCY, NOISE, RADIUS, YAW_NOISE, connect
from tests.e2e.test_live import ROS_PEER, STOPS, Watcher, arm_and_start, start_run
from tests.ros_messages import ODOMETRY, STORE, make_key

pytestmark = pytest.mark.timeout(240)


class Listener:
    """A plain zenoh client; ROS's own sessions dial their router in the same way."""

    def __init__(self, endpoint):
        self._session = connect(endpoint)

    def hear(self, key, run):
        ring = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(4))
        end = time.monotonic() + 20.0
        while (sample := ring.try_recv()) is None:
            assert time.monotonic() < end, run.text
            assert run.pump(0.02), run.text
        return sample

    def tokens(self, key):
        replies = self._session.liveliness().get(key, timeout=2.0)
        return sorted(str(r.ok.key_expr) for r in replies if r.ok is not None)

    def close(self):
        self._session.close()


@pytest.mark.realtime
def test_a_ros_subscription_finds_and_decodes_the_car(steerd, tmp_path):
    run = steerd(
        "run", "--sim", "--ros-domain", "3", "--listen", steerd.endpoint,
        "--record", tmp_path / "drive.mcap",
    )  # fmt: skip
    run.expect("DISARMED")
    with closing(Listener(steerd.endpoint)) as listener:
        name = make_key(3, "steerd/car1/odom", ODOMETRY)
        odom = listener.hear("3/*/car1/odom/**", run)
        assert str(odom.key_expr) == name
        decoded = STORE.deserialize_cdr(odom.payload.to_bytes(), ODOMETRY)
        assert decoded.child_frame_id == "base_link"
        nodes = listener.tokens("@ros2_lv/3/**/NN/**")
        assert [token.rpartition("/")[2] for token in nodes] == ["steerd_car1"]
        publishers = listener.tokens("@ros2_lv/3/**/MP/**")
        assert len(publishers) == len({token.split("/")[4] for token in publishers}) > 10
        (token,) = [t for t in publishers if "/%steerd%car1%odom/" in t]
        assert f"/{name.split('/', 4)[4]}/" in token
        drive = listener.hear("3/*/car1/drive/**", run)
    sequence, stamp_ns, size, gid = struct.unpack("<qqB16s", odom.attachment.to_bytes())
    assert sequence >= 1
    assert abs(stamp_ns - time.time_ns()) < 60e9
    assert (size, gid) == (16, xxhash.xxh3_128_digest(token.encode())[::-1])
    header, values = drive.payload.to_bytes()[:4], drive.payload.to_bytes()[-20:]
    assert header == b"\0\1\0\0"
    assert struct.unpack("<5f", values)[1] == 0.0
    assert run.interrupt() == 0, run.text


def make_lidar_car(path: Path) -> Path:
    """The car file as docs/how-to/use-with-ros.md changes it for a localiser."""
    text = default_car_path().read_text()
    changed = {
        "pose_position_sd": NOISE, "pose_yaw_sd": YAW_NOISE, "pose_delay": LATENCY,
        "marker_rear_x": 0.0,
    }  # fmt: skip
    for name, value in changed.items():
        text, count = re.subn(rf"^{name} = \S+", f"{name} = {value}", text, flags=re.MULTILINE)
        assert count == 1
    path.write_text(text)
    return path


@pytest.mark.realtime
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_a_localisers_poses_drive_the_car_and_their_end_stops_it(end, steerd, tmp_path, capsys):
    port, url = steerd.sim(tmp_path)
    given = ("--mocap", "ros2:///pf/pose/odom", "--car", make_lidar_car(tmp_path / "car.toml"))
    run, record = start_run(steerd, tmp_path, "--port", port, *given)
    run.expect("first pose")
    track = tmp_path / "track"
    peer = steerd("localise", url, steerd.endpoint, track, module=ROS_PEER)
    run.expect("READY")
    arm_and_start(steerd)
    with closing(Watcher(steerd.endpoint)) as watcher:
        driven = watcher.driving(run, 5.0)
        assert driven.mode not in STOPS, run.text
        watcher.stopped_by_silence(run, peer, end)
    peer.send(signal.SIGKILL)
    run.interrupt()
    assert "W1 " in next(c.text for c in changes(record) if c.to_state in STOPS)
    x, y = np.loadtxt(track).T
    assert np.abs(np.hypot(x, y - RADIUS) - RADIUS).max() < 0.04
    assert np.ptp(np.unwrap(np.arctan2(y - RADIUS, x))) * RADIUS > 3.0, "it drove"
    poses = open_session(record).columns(m.MocapPose)
    off = np.hypot(poses["x"], poses["y"] - RADIUS) - RADIUS
    assert np.std(off) == pytest.approx(NOISE, rel=0.3), "as a LiDAR sees it"
    assert np.mean(poses["reject"] == "") > 0.95
    assert replays(record, capsys)
