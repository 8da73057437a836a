"""F1TENTH's `vesc.yaml`: read, written, refused, and through `steerd config`."""

import tomllib

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.vesc_yaml import make_car_values, read_vesc_yaml
from steerd.vesc_link.scaling import F1TENTH

YAML = """/**:
  ros__parameters:
    # erpm (electrical rpm) = speed_to_erpm_gain * speed
    speed_to_erpm_gain: 4200.5   # measured
    speed_to_erpm_offset: -12
    steering_angle_to_servo_gain: -0.9
    steering_angle_to_servo_offset: 0.48
    wheelbase: .25

vesc_driver:
  ros__parameters:
    port: "/dev/sensors/vesc"
    servo_min: 0.2
    servo_max: 0.8
    speed_max: 20000.0
    speed_min: -20000.0
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("port: 1", "no gain"),
        ("servo_min: low", "not a number"),
        ("servo_min: 0.1\nservo_min: 0.2", "twice"),
        ("servo_min: 0.9\nservo_max: 0.1", "servo limits"),
        ("speed_to_erpm_gain: nan", "not a number"),
    ],
)
def test_an_invalid_yaml_is_refused(text, said):
    with pytest.raises(SteerdError, match=said):
        read_vesc_yaml(text, F1TENTH)


def test_yaml_by_command_line(tmp_path, capsys):
    yaml, car, back = tmp_path / "vesc.yaml", tmp_path / "car.toml", tmp_path / "back.yaml"
    yaml.write_text(YAML)
    assert run_cli(["config", "--from-vesc-yaml", str(yaml)]) == 0
    car.write_text(capsys.readouterr().out)
    assert "# erpm per m/s" in car.read_text()
    table = tomllib.loads(car.read_text())["vesc"]
    assert all(table[key] == value for (_, key), value in
               make_car_values(read_vesc_yaml(YAML, F1TENTH)).items())  # fmt: skip
    assert run_cli(["config", "--check", str(car), "--to-vesc-yaml", str(back)]) == 0
    assert read_vesc_yaml(back.read_text(), F1TENTH) == read_vesc_yaml(YAML, F1TENTH)
    assert run_cli(["config", "--from-vesc-yaml", str(tmp_path / "no.yaml")]) == 3
