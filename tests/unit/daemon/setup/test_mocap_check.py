"""`steerd mocap check`: a sound room passes, each wrong axis or unit is named with its remedy."""

import numpy as np
import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.setup.mocap_check import Movement, check_movement
from steerd.mocap_link import sockets
from steerd.mocap_link.frame import FrameConfig, make_body_pose, make_planar_pose
from steerd.mocap_link.source import SourceState, SourceStatus
from steerd.steer_bus import clock


def movement(seen_by, true=None, *, straight=True, seed=0, length=1.0):
    """A push (or a figure of eight) through a room as it is, seen with a configuration."""
    true = true or FrameConfig(up="y", body_forward="+z")
    s = np.linspace(0.0, length if straight else 8.0, 400)
    yaw = 0.4 + (0.0 * s if straight else np.cumsum(0.8 * np.sin(s)) * (s[1] - s[0]))
    x, y = (np.cumsum(f(yaw)) * (s[1] - s[0]) for f in (np.cos, np.sin))
    noise = np.random.default_rng(seed).normal(size=(3, len(s)))
    rows = []
    for i in range(len(s)):
        at, q = make_body_pose(
            true, x[i] + 4e-4 * noise[0, i], y[i] + 4e-4 * noise[1, i], yaw[i] + 2e-3 * noise[2, i],
            0.1,
        )  # fmt: skip
        p = make_planar_pose(seen_by, at, q)
        rows.append((0.01 * i, p.x, p.y, p.yaw, p.height, p.tilt))
    return Movement(*np.array(rows).T)


def failed(m, refused=0):
    return {c.name: c.fix for c in check_movement(m, refused) if not c.ok}


@pytest.mark.parametrize("straight", [True, False])
def test_a_sound_room_passes(straight):
    checks = check_movement(movement(FrameConfig(up="y", body_forward="+z"), straight=straight), 0)
    assert [c.name for c in checks if not c.ok] == []
    assert len(checks) == (5 if straight else 6)
    assert all(c.ok for c in checks)


def test_the_wrong_up_axis():
    wrong = failed(movement(FrameConfig(up="z", body_forward="+x")))
    assert "[mocap] up" in wrong["height"]


@pytest.mark.parametrize(
    ("axis", "said"), [("+x", "90°"), ("-x", "90°"), ("-z", "turn [mocap] body_forward round")]
)
def test_the_wrong_forward_axis(axis, said):
    wrong = failed(movement(FrameConfig(up="y", body_forward=axis)))
    assert list(wrong) == ["heading"]
    assert said in wrong["heading"]


def test_a_body_a_little_askew_is_a_case_for_calibration():
    seen = FrameConfig(up="y", body_forward="+z", mount_yaw=0.2)
    assert "steerd mocap calibrate" in failed(movement(seen))["heading"]


def test_a_mirrored_world():
    m = movement(FrameConfig(up="y", body_forward="+z"), straight=False)
    mirrored = Movement(m.t, m.x, -m.y, m.yaw, m.height, m.tilt)
    assert "mirrored" in failed(mirrored)["turning"]


def test_a_car_that_stands_leans_or_is_not_seen():
    m = movement(FrameConfig(up="y", body_forward="+z"), length=0.1)
    assert "push the car" in failed(m)["distance"]
    m = movement(FrameConfig(up="y", body_forward="+z"))
    assert "orientation" in failed(Movement(
        m.t, m.x, m.y, m.yaw, m.height, m.tilt + 0.2))["level"]  # fmt: skip
    assert "probe" in failed(m, refused=100)["stream"]
    far = Movement(m.t, 1e4 * m.x, 1e4 * m.y, m.yaw, m.height, m.tilt)
    assert "millimetres" in failed(far)["distance"]


class Deaf:
    """A receiver whose server never answers."""

    def fds(self):
        return []

    def on_timer(self, now_ns):
        return []

    def status(self):
        return SourceStatus(SourceState.CONNECTING, False, "no answer for 3 s")

    def close(self):
        pass


class Seconds:
    """A clock that is a second later at each look."""

    looks = 0

    def now_ns(self):
        type(self).looks += 1
        return self.looks * 1_000_000_000


def test_nobody_pushes_for_a_source_that_does_not_answer(monkeypatch, capsys):
    monkeypatch.setattr(sockets, "make_receiver", lambda url, config: Deaf())
    monkeypatch.setattr(clock, "MonotonicClock", Seconds)
    line = ["mocap", "check", "--mocap", "natnet://192.0.2.1/car", "--seconds", "60"]
    assert run_cli(line) == ExitCode.UNREADABLE
    said = capsys.readouterr().err
    assert "no answer for 3 s" in said
    assert "push" not in said
    assert Seconds.looks < 20, "given up long before the 60 s"
