"""The whole daemon in virtual time: lanes by the simulated car's true position, seeds, replays."""

import hashlib
import re
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import replays, rms
from tests.replays import copy_session

SLOW_STEERING = "--effect steer_delay=0.03 --effect steer_lag=0.03"
"""30 ms beside the servo's own 10 ms; 50 ms + 30 ms of lag."""


@pytest.mark.parametrize(("line", "bound"), [
    ("--path circle:radius=2 --speed 1 --duration 16", 0.0015),
    ("--path figure8 --speed 1.5 --duration 19", 0.002),
    ("--path figure8 --speed 1.5 --duration 5 --rate 200", 0.0015),
    ("--path line --speed 1.5 --duration 6", 0.001),
    ("--path circle:radius=2 --speed 1 --duration 6 --car paper.toml", 0.02),
])  # fmt: skip
def test_the_car_keeps_its_lane_and_replays(drive_fast, tmp_path, monkeypatch, capsys, line, bound):
    """The first two go round once after they have settled: 12.6 m, 22.7 m; the last is the paper's
    design.
    """
    monkeypatch.chdir(tmp_path)
    text = default_car_path().read_text()
    assert text.count('design = "lqr" ') == 1
    Path("paper.toml").write_text(text.replace('design = "lqr" ', 'design = "pole_placement" '))
    driven = drive_fast(line)
    assert not driven.faulted, driven.reason
    assert rms(driven.offsets()) <= bound
    assert replays(driven.session, capsys)


@pytest.mark.parametrize("path", ["circle:radius=2 --speed 1", "figure8 --speed 1.5"])
def test_delay_and_slow_servo_leave_the_loop_stable(drive_fast, capsys, path):
    """A loop at its edge oscillates: its errors would grow, or the limiter would saturate."""
    driven = drive_fast(f"--path {path} --duration 10 {SLOW_STEERING}")
    assert not driven.faulted, driven.reason
    offsets = driven.offsets()
    third = len(offsets) // 3
    assert rms(offsets) <= 0.008
    assert rms(offsets[-third:]) <= max(1.5 * rms(offsets[:third]), 0.005)
    assert replays(driven.session, capsys)


# --- repeatability
def content(session):
    return [(r.topic, r.log_ns, r.publish_ns, r.data) for r in open_session(session).messages()]


def test_same_seed_same_bytes_other_seed_other_bytes(drive_fast, tmp_path, cli):
    line = "--path figure8 --speed 1.5 --duration 1 --seed 7"
    first, second = drive_fast(line), drive_fast(line)
    assert first.wire == second.wire
    files = [hashlib.sha256(d.session.read_bytes()).hexdigest() for d in (first, second)]
    assert files[0] == files[1]
    record = tmp_path / "again.mcap"
    argv = ["run", "--sim", "--fast", *line.split(), "--record", str(record)]
    assert first.wire[:16] in cli(*argv).out
    assert content(record) == content(first.session)
    other = drive_fast(line.replace("--seed 7", "--seed 8"))
    assert other.wire != first.wire
    assert content(other.session) != content(first.session)


def test_a_pose_that_was_moved_in_the_recording_is_found(drive_fast, tmp_path, capsys, cli):
    """By 2 mm and 4 mrad: the filter's gate refuses more, and less turns no servo step."""
    driven = drive_fast("--path circle:radius=2 --speed 1 --duration 2")
    assert replays(driven.session, capsys)
    poses = [r.log_ns for r in open_session(driven.session).messages("/steerd/car1/mocap")]

    def tamper(record):
        if not record.topic.endswith("/mocap") or record.log_ns != poses[len(poses) // 2]:
            return record.data
        pose = record.decode()
        return encode(replace(pose, y=pose.y + 0.002, yaw=pose.yaw + 0.004))

    tampered = copy_session(driven.session, tmp_path / "tampered.mcap", change=tamper)
    said = cli("replay", tampered, code=7).out
    first, last = said.splitlines()[0], said.splitlines()[-1]
    assert re.match(r"tick \d+ .*: recorded SPEED steer .*; replayed SPEED steer ", first)
    assert re.fullmatch(r"\d+ commands replayed: \d+ of them differ", last)


def ellipse(count):
    """Points of an ellipse with semi-axes 3 m and 2.5 m, driven counter-clockwise from (3, 0)."""
    t = np.arange(count) * 2.0 * pi / count
    return 3.0 * np.cos(t), 2.5 * np.sin(t)


def test_a_path_from_a_file_is_driven_and_replays_without_the_file(drive_fast, tmp_path, capsys):
    file = tmp_path / "track.csv"
    points = np.column_stack([*ellipse(80), *np.full((2, 80), 0.8)])
    head = "x_m, y_m, w_tr_right_m, w_tr_left_m"
    np.savetxt(file, points, delimiter=", ", fmt="%.6f", header=head)
    driven = drive_fast(f"--path csv:{file} --speed 1.2 --duration 6")
    assert not driven.faulted, driven.reason
    x, y = ellipse(4000)
    placed = np.column_stack([y, 3.0 - x])  # (3, 0) heading +y becomes the origin heading +x
    assert rms(driven.offsets(placed)) <= 0.02
    assert driven.track[-1][1] ** 2 + driven.track[-1][2] ** 2 > 1.0
    file.unlink()
    assert replays(driven.session, capsys)
