"""The mount is recovered from drives with a known one; drives that identify none are refused."""

from dataclasses import astuple, fields

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.params import wheelbase
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.setup.mount_calibration import Drive, Mount, calibrate_mount, slip_per_accel

CAR = load_car(default_car_path()).car
TRUTH = Mount(np.radians(3.0), 0.21, -0.015, 1.07, 0.018)
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
    slip = -slip_per_accel(CAR) * speed * rate_true
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


@pytest.mark.parametrize(("seed", "front"), [(0, 0.0), (1, 0.0), (2, 0.5), (3, 1.0)])
def test_the_injected_truth_is_found(seed, front):
    found = calibrate_mount(slow_drive(TRUTH, seed=seed, front=front), CAR, front)
    mount = found.mount
    assert mount.yaw == pytest.approx(TRUTH.yaw, abs=np.radians(0.1))
    assert mount.rear_x == pytest.approx(TRUTH.rear_x, abs=2e-3)
    assert mount.rear_y == pytest.approx(TRUTH.rear_y, abs=2e-3)
    assert mount.speed_gain == pytest.approx(TRUTH.speed_gain, rel=2e-3)
    assert mount.delay == pytest.approx(TRUTH.delay, abs=6e-3)
    assert found.warnings == ()
    assert found.seconds > 55.0


def test_the_standard_errors_cover_the_truth():
    within = total = 0
    for seed in range(8):
        found = calibrate_mount(slow_drive(TRUTH, seed=100 + seed, seconds=30), CAR)
        for value, sd, true in zip(*map(astuple, (found.mount, found.sd, TRUTH)), strict=True):
            within += abs(value - true) < 3.5 * sd + 1e-4
            total += 1
    assert total == 8 * len(fields(Mount))
    assert within >= 0.85 * total


@pytest.mark.parametrize("turn", [np.pi / 2, -np.pi / 2, np.pi - 0.1, -2.0])
def test_a_body_that_lies_across_or_backwards(turn):
    truth = Mount(turn, -0.05, 0.08, 0.93, 0.0)
    found = calibrate_mount(slow_drive(truth), CAR).mount
    assert np.angle(np.exp(1j * (found.yaw - turn))) == pytest.approx(0.0, abs=3e-3)
    assert (found.rear_x, found.rear_y) == pytest.approx((-0.05, 0.08), abs=3e-3)
    assert found.speed_gain == pytest.approx(0.93, rel=3e-3)


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
