"""Sessions as input of calibrations: the body's poses, wheel speed and commands on one clock."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.offline.virtual import drive
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.setup.calibration_data import (
    body_track,
    load_recorded,
    make_drive,
    make_motion,
    steering_commands,
    wheel_speed,
)

SPEED = 1.0
OPTIONS = RunOptions(
    car_file="", path="circle:radius=2", speed=SPEED, simulated=True, auto_arm=True, duration_s=2.0
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Two seconds of a circle on simulated hardware."""
    path = tmp_path_factory.mktemp("calibration") / "circle.mcap"
    record_virtual(make_plan(OPTIONS), path, drive)
    return load_recorded(path)


def test_poses_rise_and_are_accepted_ones(recorded):
    assert (np.diff(recorded.poses["t_valid_ns"]) > 0).all()
    assert set(recorded.poses["reject"]) == {""}
    assert recorded.start_ns == recorded.poses["t_valid_ns"][0]


def test_the_body_is_the_car_moved_by_a_constant_offset_of_the_mount(recorded):
    t, x, y, yaw = body_track(recorded)
    car = recorded.poses
    turn = np.unwrap(yaw - car["yaw"])
    assert t[0] == 0.0
    assert np.ptp(turn) < 1e-9
    ahead = (x - car["x"]) * np.cos(car["yaw"]) + (y - car["y"]) * np.sin(car["yaw"])
    left = (y - car["y"]) * np.cos(car["yaw"]) - (x - car["x"]) * np.sin(car["yaw"])
    assert max(np.ptp(ahead), np.ptp(left)) < 1e-9


def test_wheel_speed_and_commands_are_on_the_clock_of_the_poses(recorded):
    t_pose = body_track(recorded)[0]
    t, speed = wheel_speed(recorded)
    assert np.quantile(speed, 0.9) == pytest.approx(SPEED, rel=0.1)
    moving = t[speed > 0.5 * SPEED]
    motion = make_motion(recorded)
    t_order, steer = steering_commands(recorded)
    assert t_pose[0] <= t_order[0] < moving[0] < moving[-1] < t_pose[-1]
    # The circle turns left: wheelbase over radius, give or take the car's understeer.
    wheelbase = recorded.settings.file.car.lf + recorded.settings.file.car.lr
    assert np.median(steer) == pytest.approx(wheelbase / 2.0, rel=0.3)
    assert np.quantile(motion.speed, 0.9) == pytest.approx(SPEED, rel=0.1)


def test_a_drive_for_the_mount_holds_both(recorded):
    made = make_drive(recorded)
    assert {len(made.t), len(made.x), len(made.y), len(made.yaw)} == {len(recorded.poses["x"])}
    assert len(made.t_wheel) == len(made.wheel) > 100


def test_an_imported_log_has_no_body(recorded):
    flat = {**recorded.poses, "z_raw": np.full_like(recorded.poses["z_raw"], np.nan)}
    with pytest.raises(SteerdError, match=r"not its body's.*\[frame\]"):
        body_track(replace(recorded, poses=flat))


def test_what_a_session_lacks_is_named(recorded):
    empty = replace(recorded, read=replace(recorded.read, tables={}))
    with pytest.raises(SteerdError, match="no wheel speed"):
        wheel_speed(empty)
    with pytest.raises(SteerdError, match="no steering commands"):
        steering_commands(empty)
