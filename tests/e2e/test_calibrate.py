"""Calibration of simulated drives whose mount, gain, delay and steering were made up beforehand."""

import re
import tomllib

import pytest

TRUTH = (
    "--effect speed_scale=1.05 --effect mocap_latency=0.02 --effect marker_offset=0.03,-0.02 "
    "--effect mocap_yaw=0.04"
)


def test_mocap_calibrate_finds_what_was_injected(drive_fast, tmp_path, cli):
    drive = drive_fast(f"--path figure8 --speed 1 --duration 25 {TRUTH}").session
    out = tmp_path / "car.toml"
    assert len(cli("mocap", "calibrate", drive, "-o", out).out.splitlines()) < 12
    car = tomllib.loads(out.read_text())
    assert car["mocap"]["mount_yaw_deg"] == pytest.approx(2.292, abs=0.1)
    assert car["mocap"]["marker_rear_x"] == pytest.approx(0.17145 + 0.03, abs=6e-3)
    assert car["mocap"]["marker_rear_y"] == pytest.approx(-0.02, abs=3e-3)
    # The simulated wheel turns with the centre of gravity, 0.3 % faster than the rear axle.
    assert car["vesc"]["erpm_gain"] == pytest.approx(4614 / 1.05, rel=5e-3)
    assert car["car"]["pose_delay"] == pytest.approx(0.02, abs=6e-3)
    assert "# m, body origin ahead" in out.read_text()
    cli("config", "--check", out)
    assert cli("mocap", "check", drive).out.count("pass") == 6
    assert "-o car.toml" in cli("mocap", "calibrate", drive).out


def test_servo(drive_fast, tmp_path, cli):
    effects = "--effect steer_gain=0.9 --effect steer_bias=0.02"
    session = drive_fast(f"--path figure8 --speed 1 --duration 25 {effects}").session
    out = tmp_path / "car.toml"
    said = cli("calibrate", "servo", session, "-o", out).out
    found = re.search(r"wheel angle = ([\d.]+) .* command ([+-][\d.]+)°", said)
    assert float(found[1]) == pytest.approx(0.9, rel=0.02)
    assert float(found[2]) == pytest.approx(1.146, abs=0.1)
    car = tomllib.loads(out.read_text())
    vesc = car["vesc"]
    assert car["car"]["steer_gain"] == 1.0, "the servo's gain has taken it in"
    assert vesc["servo_gain"] == pytest.approx(-1.2135 / 0.9, rel=0.02)
    assert vesc["servo_offset"] == pytest.approx(0.5304 + 1.2135 / 0.9 * 0.02, abs=3e-3)
