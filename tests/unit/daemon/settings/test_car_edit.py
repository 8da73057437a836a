"""Edits of a car file: comments and order stay, invalid results are refused."""

import tomllib

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.car_edit import edit_car, make_car_values, read_vesc_yaml
from steerd.vesc_link.scaling import F1TENTH


def test_edits_keep_comments_and_order():
    edits = {("mocap", "marker_rear_x"): 0.21, ("vesc", "erpm_gain"): 4300.0}
    car = load_car(default_car_path())
    text = edit_car(car, edits | {("vesc", "uuid"): "ab" * 12}).text
    old, new = car.text.splitlines(), text.splitlines()
    kept = [line for line in new if "uuid" not in line]
    changed = [(a, b) for a, b in zip(old, kept, strict=True) if a != b]
    assert [b.split("=")[0].strip() for _, b in changed] == ["erpm_gain", "marker_rear_x"]
    assert all(a.split("#")[1] == b.split("#")[1] for a, b in changed)
    assert tomllib.loads(text)["vesc"]["uuid"] == "ab" * 12


@pytest.mark.parametrize(("key", "value", "said"), [
    (("vesc", "servo_gain"), 0.0, "servo_gain must not be zero"),
    (("mocap", "marker_raer"), 0.0, "marker_raer"), (("car", "mass"), -1.0, r"car\.mass"),
])  # fmt: skip
def test_edits_with_an_invalid_result_are_refused(key, value, said):
    with pytest.raises(SteerdError, match=said):
        edit_car(load_car(default_car_path()), {key: value})


# F1TENTH's `vesc.yaml`: read, written, refused, and through `steerd config`.
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


@pytest.mark.parametrize(("text", "said"), [
    ("port: 1", "no gain"), ("servo_min: low", "not a number"),
    ("servo_min: 0.1\nservo_min: 0.2", "twice"), ("servo_min: 0.9\nservo_max: 0.1", "servo limits"),
    ("speed_to_erpm_gain: nan", "not a number"),
])  # fmt: skip
def test_an_invalid_yaml_is_refused(text, said):
    with pytest.raises(SteerdError, match=said):
        read_vesc_yaml(text, F1TENTH)


def test_yaml_by_command_line(tmp_path, cli):
    yaml, car, back = tmp_path / "vesc.yaml", tmp_path / "car.toml", tmp_path / "back.yaml"
    yaml.write_text(YAML)
    car.write_text(cli("config", "--from-vesc-yaml", yaml).out)
    assert "# erpm per m/s" in car.read_text()
    table = tomllib.loads(car.read_text())["vesc"]
    assert all(table[key] == value for (_, key), value in
               make_car_values(read_vesc_yaml(YAML, F1TENTH)).items())  # fmt: skip
    assert run_cli(["config", "--check", str(car), "--to-vesc-yaml", str(back)]) == 0
    assert read_vesc_yaml(back.read_text(), F1TENTH) == read_vesc_yaml(YAML, F1TENTH)
