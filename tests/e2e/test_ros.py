"""`--ros-domain`: a subscriber with nothing of ours sees the car as rmw_zenoh would."""

import json
import signal
import struct
import time
from contextlib import closing

import pytest
import xxhash  # noqa: TID251
import zenoh  # noqa: TID251
from rosbags.typesys import Stores, get_typestore

from steerd.daemon.cli.main import run_cli

pytestmark = pytest.mark.timeout(240)


class Listener:
    """A plain zenoh client; ROS's own sessions dial their router in the same way."""

    def __init__(self, endpoint):
        config = zenoh.Config()
        config.insert_json5("mode", json.dumps("client"))
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = zenoh.open(config)

    def hear(self, key, run):
        """The first sample of a key."""
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
    store = get_typestore(Stores.ROS2_HUMBLE)
    with closing(Listener(steerd.endpoint)) as listener:
        hash_of = store.hash_rihs01("nav_msgs/msg/Odometry")
        name = f"3/steerd/car1/odom/nav_msgs::msg::dds_::Odometry_/{hash_of}"
        odom = listener.hear("3/*/car1/odom/**", run)
        assert str(odom.key_expr) == name
        decoded = store.deserialize_cdr(odom.payload.to_bytes(), "nav_msgs/msg/Odometry")
        assert decoded.child_frame_id == "base_link"
        nodes = listener.tokens("@ros2_lv/3/**/NN/**")
        assert [token.rpartition("/")[2] for token in nodes] == ["steerd_car1"]
        publishers = listener.tokens("@ros2_lv/3/**/MP/**")
        assert len(publishers) == len({token.split("/")[4] for token in publishers}) > 10
        (token,) = [t for t in publishers if "/%steerd%car1%odom/" in t]
        assert f"/nav_msgs::msg::dds_::Odometry_/{hash_of}/" in token
        drive = listener.hear("3/*/car1/drive/**", run)
    sequence, stamp_ns, size, gid = struct.unpack("<qqB16s", odom.attachment.to_bytes())
    assert sequence >= 1
    assert abs(stamp_ns - time.time_ns()) < 60e9
    assert size == 16
    assert gid == xxhash.xxh3_128_digest(token.encode())[::-1]
    header, values = drive.payload.to_bytes()[:4], drive.payload.to_bytes()[-20:]
    assert header == b"\0\1\0\0"
    assert struct.unpack("<5f", values)[1] == 0.0
    run.send(signal.SIGINT)
    assert run.wait() == 0, run.text


def test_a_domain_that_is_none_is_told(capsys):
    assert run_cli(["run", "--sim", "--ros-domain", "233"]) == 2
    assert "0 to 232" in capsys.readouterr().err


def test_a_lab_with_keys_shows_nothing_to_ros(tmp_path, capsys):
    assert run_cli(["run", "--sim", "--ros-domain", "0", "--lab", str(tmp_path)]) == 2
    assert "--ros-domain" in capsys.readouterr().err
