"""A recorded session becomes the drive that it was, on one clock."""

import numpy as np
import pytest

from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import (
    BODY,
    WORLD,
    Actuation,
    ActuationMode,
    MocapPose,
    VescImu,
    VescTelemetry,
    make_header,
)
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.topics import ACTUATION, IMU, MOCAP, VESC, make_session_topic
from steerd.sysid.data.dataset import load_run

EPOCH = 1_700_000_000_000_000_000
BOOT = 55_000_000_000
NAN = float("nan")


def _pose(t_ns: int, x: float, yaw: float, reject: str) -> MocapPose:
    header = make_header(EPOCH + t_ns, WORLD)
    raw = (x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    return MocapPose(
        header, t_ns, t_ns + 2_000_000, 0, 0, 0, 1, *raw, NAN, x, 0.5, yaw, 0.0, 0.0, reject
    )


def _messages(t_ns: int, k: int) -> list[tuple[str, object]]:
    x, header = 0.015 * k, make_header(EPOCH + t_ns, BODY)
    steer = 0.1 if k >= 100 else 0.0
    mode = ActuationMode.BRAKE if k < 20 else ActuationMode.SPEED
    yaw = (3.1 + 0.01 * k + np.pi) % (2 * np.pi) - np.pi
    pose = _pose(t_ns, x + (5.0 if k == 150 else 0.0), yaw, "jump" if k == 150 else "")
    sent = (t_ns - 1_000_000, t_ns + 1_000_000)
    return [
        (MOCAP.name, pose),
        (ACTUATION.name, Actuation(header, k, mode, steer, 1.5, NAN, b"")),
        (VESC.name, VescTelemetry(header, *sent, -1, 9228, -1, -1, -1, -1, *(NAN,) * 10)),
        (IMU.name, VescImu(header, *sent, *(NAN,) * 5, 1.0, *(NAN,) * 4)),
    ]


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "drive.mcap"
    topics = {make_session_topic("car", t): t.message for t in (MOCAP, ACTUATION, VESC, IMU)}
    writer = SessionWriter(
        path, topics, {"steerd.scaling": {"erpm_gain": "4614", "erpm_offset": "0"}}
    )
    for k in range(400):
        t_ns = BOOT + 10_000_000 * k
        for name, message in _messages(t_ns, k):
            writer.write(f"/steerd/car/{name}", encode(message), EPOCH + t_ns)
    return writer.finish({"reason": "test"})


def test_signals_share_the_commands_clock(session):
    run = load_run(session, h=0.01)
    assert run.name == "drive.mcap"
    assert run.speed_source == "command"
    assert len(run.pose.t) == 379  # 20 before the drive, one rejected
    assert run.pose.t[:2] == pytest.approx([0.0, 0.01], abs=1e-9)
    assert run.pose.values[0] == pytest.approx([0.3, 0.5, 3.3], abs=1e-9)
    assert np.diff(run.pose.values[:, 2]).max() < 0.03
    assert run.wheel.values == pytest.approx(2.0)
    assert run.yaw_rate.values == pytest.approx(1.0)
    assert run.commands[:, 1] == pytest.approx(1.5)
    assert run.commands[79:81, 0] == pytest.approx([0.0, 0.1], abs=1e-6)
    assert run.duration == pytest.approx(3.8, abs=0.011)
