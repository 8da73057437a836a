"""The mount is recovered from drives with a known one; drives that identify none are refused."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.params import GRAVITY, wheelbase
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.offline.virtual import drive
from steerd.daemon.sessions.motion import Track
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.setup import calibration_data as data
from steerd.daemon.setup.calibration_data import Drive, load_recorded, make_drive
from steerd.daemon.setup.mount_calibration import Mount, calibrate_mount
from steerd.daemon.setup.steering_calibration import calibrate_steering
from steerd.sysid.data.dataset import Signal

CAR = load_car(default_car_path()).car
TRUTH = Mount(np.radians(3.0), 0.21, -0.015, 1.07, 0.018)
ACROSS = [
    Mount(turn, -0.05, 0.08, 0.93, 0.0) for turn in (np.pi / 2, -np.pi / 2, np.pi - 0.1, -2.0)
]
DT = 1e-3


def slow_drive(
    truth, *, seconds=60.0, seed=0, vary=True, one_side=False, straight=False, rate=120, front=0.0
):
    """Rear axle with the tyre's slip, marker and wheel as the truth says, with noise."""
    t = np.arange(0.0, seconds, DT)
    speed = 0.8 + (0.4 * np.sin(2 * np.pi * t / 7.0) if vary else 0.0)
    speed = speed * np.clip(t, 0, 1)
    curvature = 0.6 * np.sin(2 * np.pi * t / 16.0)
    curvature = np.abs(curvature) + 0.1 if one_side else 0.0 * t if straight else curvature
    rate_true = speed * curvature
    yaw = 0.7 + np.cumsum(rate_true) * DT
    slip = -speed * rate_true / (CAR.mu * GRAVITY * CAR.c_sr)
    x = np.cumsum(speed * np.cos(yaw + slip)) * DT
    y = np.cumsum(speed * np.sin(yaw + slip)) * DT
    rng = np.random.default_rng(seed)
    shown = np.arange(0.5, seconds - 0.5, 1 / rate)
    at = shown - truth.delay
    px, py, psi = (np.interp(at, t, column) for column in (x, y, yaw))
    px += np.cos(psi) * truth.rear_x - np.sin(psi) * truth.rear_y
    py += np.sin(psi) * truth.rear_x + np.cos(psi) * truth.rear_y
    noise = rng.normal(size=(3, len(at)))
    rolled = speed * (1.0 - front + front * np.hypot(1.0, wheelbase(CAR) * curvature))
    wheel = np.interp(shown, t, rolled) / truth.speed_gain + 0.01 * rng.normal(size=len(shown))
    body = np.angle(np.exp(1j * (psi + truth.yaw + 0.002 * noise[2])))
    return Drive(shown, px + 3e-4 * noise[0], py + 3e-4 * noise[1], body, shown, wheel)


@pytest.mark.parametrize(("truth", "seed", "front"), [
    (TRUTH, 0, 0.0), (TRUTH, 2, 0.5), (TRUTH, 3, 1.0), *((truth, 1, 0.0) for truth in ACROSS),
])  # fmt: skip
def test_the_injected_truth_is_found(truth, seed, front):
    found = calibrate_mount(slow_drive(truth, seed=seed, front=front), CAR, front)
    mount = found.mount
    assert np.angle(np.exp(1j * (mount.yaw - truth.yaw))) == pytest.approx(0.0, abs=np.radians(0.1))
    assert (mount.rear_x, mount.rear_y) == pytest.approx((truth.rear_x, truth.rear_y), abs=2e-3)
    assert mount.speed_gain == pytest.approx(truth.speed_gain, rel=2e-3)
    assert mount.delay == pytest.approx(truth.delay, abs=6e-3)
    assert found.warnings == ()
    assert found.seconds > 55.0


def test_the_standard_errors_cover_the_truth():
    within = []
    for seed in range(100, 108):
        found = calibrate_mount(slow_drive(TRUTH, seed=seed, seconds=30), CAR)
        off = np.abs(np.subtract(found.mount, TRUTH))
        within += list(off < 3.5 * np.array(found.sd) + 1e-4)
    assert sum(within) >= 0.85 * 8 * len(TRUTH)


def test_a_drive_that_identifies_little_is_named_or_refused():
    found = calibrate_mount(slow_drive(TRUTH, vary=False, one_side=True), CAR)
    assert any("one side" in text for text in found.warnings)
    assert any("delay is uncertain" in text for text in found.warnings)
    with pytest.raises(SteerdError, match="turns with"):
        calibrate_mount(slow_drive(TRUTH, straight=True), CAR)
    with pytest.raises(SteerdError, match=r"too short|moves for"):
        calibrate_mount(slow_drive(TRUTH, seconds=5.0), CAR)
    with pytest.raises(SteerdError, match="times as far as the wheels"):
        calibrate_mount(slow_drive(Mount(0.0, 0.2, 0.0, 1000.0, 0.0)), CAR)


# Gain, centre, delay and stops of the steering are recovered from drives with known ones.
def followed(t, command, wheel, speed, seed):
    """A track of which nothing is looked at but speed and turning, and what was commanded."""
    slip = (1 / CAR.c_sf - 1 / CAR.c_sr) / (CAR.mu * 9.81)
    rate = np.tan(wheel) * speed / (wheelbase(CAR) + slip * speed**2)
    rate += 0.02 * np.random.default_rng(seed).normal(size=t.size)
    return Track(t, t, t, t, np.full_like(t, speed), rate, 0.2), Signal(t, command)


def steered(gain, bias, delay, *, stop=1.0, amplitude=0.25):
    t = np.arange(0.0, 40.0, 0.01)
    command = amplitude * np.sin(2 * np.pi * t / 6.0) + 0.02
    wheel = np.clip(gain * np.interp(t - delay, t, command) + bias, -stop, stop)
    return followed(t, command, wheel, 1.0, 0)


def test_steering_that_meets_its_stops():
    found = calibrate_steering(*steered(1.0, 0.0, 0.05, stop=0.2, amplitude=0.32), CAR)
    assert (found.clipped_left, found.clipped_right) == (True, True)
    assert (found.left, found.right) == pytest.approx((0.2, -0.2), abs=0.01)
    assert found.gain == pytest.approx(1.0, rel=0.05)


def stepped(hold, *, seed=0, speed=1.0):
    """A drive in bends that change at once, more of them to the left; truth: 1, 0, 60 ms."""
    t = np.arange(0.0, 60.0, 0.01)
    levels = np.random.default_rng(seed).choice([0.14, 0.12, 0.09, 0.05, -0.09], int(60 / hold) + 1)
    command = levels[(t / hold).astype(int)]
    wheel = np.interp(t - 0.06, t, command)
    for _ in range(2):  # the servo's lag, and what differentiating smooths
        wheel = np.convolve(np.pad(wheel, 10, mode="edge"), np.ones(21) / 21, "valid")
    return followed(t, command, wheel, speed, seed + 10)


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_steering_do_not_dilute_the_gain(seed):
    found = calibrate_steering(*stepped(1.0, seed=seed), CAR)
    assert found.gain == pytest.approx(1.0, abs=0.02)
    assert abs(found.gain - 1.0) < 4 * found.sd_gain + 0.005
    assert found.bias == pytest.approx(0.0, abs=0.002)


def test_a_drive_too_fast_for_the_tyre_model_is_warned_of():
    assert calibrate_steering(*stepped(1.5), CAR).warnings == ()
    (warning,) = calibrate_steering(*stepped(1.5, speed=3.0), CAR).warnings
    assert "drive slower" in warning


def test_drives_that_identify_no_steering_or_badly_are_refused():
    with pytest.raises(SteerdError, match="as much as commanded") as caught:
        calibrate_steering(*steered(-1.0, 0.0, 0.05), CAR)
    assert "servo_gain" in caught.value.hint
    with pytest.raises(SteerdError, match="barely used"):
        calibrate_steering(*steered(1.0, 0.0, 0.05, amplitude=0.001), CAR)
    track, command = steered(1.0, 0.0, 0.05)
    with pytest.raises(SteerdError, match="barely moves"):
        calibrate_steering(replace(track, speed=0.0 * track.speed), command, CAR)
    with pytest.raises(SteerdError, match="swings too fast"):
        calibrate_steering(*stepped(0.1), CAR)
    track, command = steered(1.0, 0.0, 0.05, amplitude=0.04)
    noise = np.repeat(np.random.default_rng(1).normal(scale=0.06, size=40), 100)
    with pytest.raises(SteerdError, match="the steering gain is identified to") as caught:
        calibrate_steering(replace(track, yaw_rate=track.yaw_rate + noise), command, CAR)
    assert caught.value.code == ExitCode.STOPPED


# Sessions as input of calibrations: the body's poses, wheel speed and commands on one clock.
def test_rejected_poses_calibrate_nothing_and_what_a_session_lacks_is_named(tmp_path, monkeypatch):
    path, on = tmp_path / "drive.mcap", {"simulated": True, "auto_arm": True, "duration_s": 2.0}
    record_virtual(make_plan(RunOptions("", path="circle:radius=2", speed=1.0, **on)), path, drive)
    recorded = load_recorded(path)
    (name, table), *_ = ((n, t) for n, t in recorded.read.tables.items() if "reject" in t)
    jumped = np.where(np.arange(len(table["reject"])) % 10 == 3, "jump", table["reject"])
    tables = {**recorded.read.tables, name: {**table, "reject": jumped}}
    read = replace(recorded.read, tables=tables)
    monkeypatch.setattr("steerd.daemon.setup.calibration_data.load_recording", lambda _: read)
    assert set(load_recorded(path).poses["reject"]) == {""}
    empty = replace(recorded, read=replace(recorded.read, tables={}))
    with pytest.raises(SteerdError, match="no wheel speed"):
        make_drive(empty)


# The jackknife against a case with a known answer.
def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(3).normal(size=200)
    (sd,) = data.jackknife_sd(np.ones(200, dtype=bool), lambda keep: [values[keep].mean()])
    blocks = values.reshape(data.BLOCKS, -1).mean(axis=1)
    assert sd == pytest.approx(blocks.std(ddof=1) / np.sqrt(data.BLOCKS), rel=1e-9)
