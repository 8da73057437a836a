"""`steerd config`: the default is right, wrong files are named, comments survive every edit."""

import tomllib

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.car_edit import edit_text, save_values
from steerd.daemon.settings.vesc_yaml import car_values, make_vesc_yaml, read_vesc_yaml
from steerd.vesc_link.scaling import F1TENTH, Scaling

DEFAULT = default_car_path().read_text()
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


def test_what_is_printed_is_the_commented_default_and_passes_the_check(tmp_path, capsys):
    assert run_cli(["config"]) == 0
    printed = capsys.readouterr().out
    assert printed == DEFAULT
    path = tmp_path / "car.toml"
    path.write_text(printed)
    assert run_cli(["config", "--check", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "wheelbase 0.3302 m" in shown
    assert "4614 ERPM per m/s" in shown
    assert "the servo reaches 18.0° and 15.1°" in shown


@pytest.mark.parametrize(
    ("old", "new", "code", "said"),
    [
        ("mass = 3.74", "mass = -1.0", 4, "car.mass"),
        ("erpm_gain = 4614.0", "erpm_gian = 4614.0", 4, "did you mean erpm_gain?"),
        ("servo_max = 0.85", "servo_max = 0.1", 4, "servo limits"),
        ("[car]", "[cra]", 4, "[car]"),
        ("speed = 1.5 ", "speed = 9.5 ", 4, "speed_max"),
        ("brake_current_a = 20.0", "brake_current_a = 0.0", 4, "above 0 A"),
    ],
)
def test_wrong_files_are_named(tmp_path, capsys, old, new, code, said):
    path = tmp_path / "car.toml"
    assert old in DEFAULT
    path.write_text(DEFAULT.replace(old, new, 1))
    assert run_cli(["config", "--check", str(path)]) == code
    assert said in capsys.readouterr().err


def test_an_absent_file(tmp_path, capsys):
    assert run_cli(["config", "--check", str(tmp_path / "none.toml")]) == 3
    assert "steerd config" in capsys.readouterr().err


def test_edits_keep_comments_and_order(tmp_path):
    path = tmp_path / "car.toml"
    save_values(path, default_car_path(), {("mocap", "marker_rear_x"): 0.21,
                                           ("vesc", "erpm_gain"): 4300.0,
                                           ("vesc", "uuid"): "ab" * 12})  # fmt: skip
    old, new = DEFAULT.splitlines(), path.read_text().splitlines()
    changed = [(a, b) for a, b in zip(old, [n for n in new if "uuid" not in n], strict=True)
               if a != b]  # fmt: skip
    assert [b.split("=")[0].strip() for _, b in changed] == ["erpm_gain", "marker_rear_x"]
    assert all(a.split("#")[1] == b.split("#")[1] for a, b in changed)
    assert tomllib.loads(path.read_text())["vesc"]["uuid"] == "ab" * 12


def test_edits_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(SteerdError, match="servo_gain must not be zero"):
        edit_text(DEFAULT, {("vesc", "servo_gain"): 0.0})
    with pytest.raises(SteerdError, match="marker_raer"):
        edit_text(DEFAULT, {("mocap", "marker_raer"): 0.0})
    path = tmp_path / "car.toml"
    path.write_text(DEFAULT)
    with pytest.raises(SteerdError, match=r"car\.mass"):
        save_values(path, path, {("car", "mass"): -1.0})
    assert path.read_text() == DEFAULT


def test_gains_of_a_vesc_yaml():
    scaling = read_vesc_yaml(YAML, F1TENTH)
    assert scaling == Scaling(4200.5, -12.0, -0.9, 0.48, 0.2, 0.8, 20000.0)
    assert read_vesc_yaml("  servo_min: 0.3", F1TENTH).erpm_gain == F1TENTH.erpm_gain
    again = make_vesc_yaml(F1TENTH, YAML)
    assert read_vesc_yaml(again, scaling) == F1TENTH
    assert "speed_min: -23250.0" in again
    kept = [(a, b) for a, b in zip(YAML.splitlines(), again.splitlines(), strict=True) if a != b]
    assert len(kept) == 8
    assert "4614.0   # measured" in again
    assert 'port: "/dev/sensors/vesc"' in again
    assert read_vesc_yaml(make_vesc_yaml(scaling), F1TENTH) == scaling


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
def test_yaml_that_cannot_be(text, said):
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
               car_values(read_vesc_yaml(YAML, F1TENTH)).items())  # fmt: skip
    assert run_cli(["config", "--check", str(car), "--to-vesc-yaml", str(back)]) == 0
    assert read_vesc_yaml(back.read_text(), F1TENTH) == read_vesc_yaml(YAML, F1TENTH)
    assert run_cli(["config", "--from-vesc-yaml", str(tmp_path / "no.yaml")]) == 3
