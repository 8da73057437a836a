"""The speed profile's limits and the reference's ramps."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import Path
from steerd.car_model.path.path_spec import parse_path
from steerd.controller.config import ControllerConfig
from steerd.controller.speed import SpeedProfile, make_speed_profile, profile_speed, step_speed

CONFIG = ControllerConfig(speed=3.0, lateral_accel_max=2.0, accel_max=1.0, decel_max=2.0)


def profile_of(path: Path, config: ControllerConfig = CONFIG) -> SpeedProfile:
    return make_speed_profile(DEFAULT_CAR, path, config)


def test_a_circle_is_driven_at_its_lateral_limit() -> None:
    profile = profile_of(parse_path("circle:radius=2"))
    np.testing.assert_allclose(profile.speed, 2.0)  # sqrt(2 m/s^2 * 2 m)
    assert profile.fastest == pytest.approx(2.0)


def test_no_limit_is_exceeded_anywhere_round_a_figure_eight() -> None:
    path = parse_path("figure8:radius=1")
    v = np.array(profile_of(path).speed)
    assert (v**2 * np.abs(path.curvature)).max() <= 2.0 + 1e-9
    gain = (np.roll(v, -1) ** 2 - v**2) / (2.0 * path.step)  # also from the last to the first
    assert gain.max() <= 1.0 + 1e-9
    assert gain.min() >= -2.0 - 1e-9
    assert v.max() > 1.2 * v.min()


def test_an_open_path_ends_standing() -> None:
    path = parse_path("line:length=10")
    profile = profile_of(path)
    assert profile.speed[0] == 3.0
    assert profile.speed[-1] == 0.0
    s = np.array(path.s)
    np.testing.assert_allclose(
        np.minimum(3.0, np.sqrt(2.0 * 2.0 * (10.0 - s))), profile.speed, atol=1e-6
    )


def test_a_files_speeds_cap_it_unless_configured_not_to() -> None:
    path = parse_path("circle:radius=20")
    slow = replace(path, speed=(0.7,) * len(path.x))
    assert profile_of(slow).fastest == pytest.approx(0.7)
    assert profile_of(slow, replace(CONFIG, file_speeds=False)).fastest == 3.0


def test_the_profile_is_read_ahead_by_the_drives_lag() -> None:
    path = parse_path("line:length=10")
    profile = profile_of(path)
    assert profile.preview_s == pytest.approx(DEFAULT_CAR.speed_lag + DEFAULT_CAR.drive_delay)
    ahead = profile_speed(profile, 9.0, 2.0)
    assert ahead == pytest.approx(math.sqrt(4.0 * (1.0 - 0.2)), abs=1e-3)
    assert profile_speed(profile, 9.0, -1.0) == pytest.approx(2.0, abs=1e-3)


def test_the_reference_climbs_at_the_start_ramp_and_stops_at_the_stop_ramp() -> None:
    config = ControllerConfig(start_ramp=1.5, stop_ramp=1.0)
    speed, climbed = 0.0, []
    for _ in range(100):
        speed = step_speed(speed, 1.0, 0.01, config, stop=False)
        climbed.append(speed)
    assert climbed[0] == pytest.approx(0.015)
    assert climbed[-1] == 1.0
    assert climbed.index(1.0) == 66
    for _ in range(50):
        speed = step_speed(speed, 1.0, 0.01, config, stop=True)
    assert speed == pytest.approx(0.5)
    for _ in range(60):
        speed = step_speed(speed, 1.0, 0.01, config, stop=True)
    assert speed == 0.0


def test_the_reference_follows_the_profile_down() -> None:
    assert step_speed(2.0, 1.2, 0.01, ControllerConfig(), stop=False) == 1.2
