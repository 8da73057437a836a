"""Settings of a car file: the default is valid, a wrong value or key is named with its remedy."""

import pytest
import tomlkit

from steerd.car_model.car_file import default_car_path, parse_car
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.config import make_settings

DEFAULT = default_car_path().read_text()


def test_what_is_printed_is_the_commented_default_and_passes_the_check(tmp_path, capsys):
    assert run_cli(["config"]) == 0
    printed = capsys.readouterr().out
    assert printed == DEFAULT
    assert max(map(len, printed.splitlines())) <= 80
    path = tmp_path / "car.toml"
    path.write_text(printed)
    assert run_cli(["config", "--check", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "wheelbase 0.3302 m" in shown
    assert "4614 ERPM per m/s" in shown
    assert "the servo reaches 18.0° and 15.1°" in shown
    assert "tolerates 175 ms more delay" in " ".join(shown.split())
    assert max(len(line) for line in shown.replace(str(path), "car.toml").splitlines()) <= 80


@pytest.mark.parametrize(
    ("old", "new", "code", "said"),
    [
        ("mass = 3.74", "mass = -1.0", 4, "car.mass"),
        ("erpm_gain = 4614.0", "erpm_gian = 4614.0", 4, "did you mean erpm_gain?"),
        ("servo_max = 0.85", "servo_max = 0.1", 4, "servo limits"),
        ("[car]", "[cra]", 4, "[car]"),
        ("[limits]", "[limit]", 4, "did you mean [limits]?"),
        ("mass = 3.74", "masss = 3.74", 4, "did you mean mass?"),
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


def settings_with(tmp_path, section, **values):
    """Settings of the default car file with other values in a section."""
    document = tomlkit.parse(DEFAULT)
    document.setdefault(section, tomlkit.table()).update(values)
    return make_settings(parse_car(tomlkit.dumps(document), tmp_path / "car.toml"))


@pytest.mark.parametrize(
    ("section", "values", "said"),
    [
        ("safety", {"jump_speed": 9}, "jump_speed = 9 m/s is outside 1..8 m/s: the car file may"),
        ("safety", {"late_run": 4}, "late_run = 4 ticks is outside 1..3 ticks"),
        ("safety", {"jump_frames": True}, "Expected `int`, got `bool`"),
        ("safety", {"fence": [[0, 0], [1, 0]]}, "three corners"),
        ("record", {"flush_ms": 9}, "10 to 250 ms"),
        ("record", {"flush_ms": 251}, "10 to 250 ms"),
        ("record", {"requires": True}, "did you mean required?"),
        ("record", {"disk_free_min_mb": 99}, "at least 100 MB"),
    ],
)
def test_a_value_outside_its_range_is_refused_with_range_and_unit(tmp_path, section, values, said):
    with pytest.raises(SteerdError) as error:
        settings_with(tmp_path, section, **values)
    assert f"[{section}]" in error.value.what
    assert said in error.value.what


def test_thresholds_of_a_car_file_replace_the_defaults(tmp_path):
    settings = settings_with(tmp_path, "safety", jump_speed=5, deadman=False)
    assert (settings.thresholds.jump_speed, settings.deadman) == (5.0, False)
    assert settings.thresholds.jump_frames == 3
