"""Edits of a car file: comments and order stay, invalid results are refused."""

import tomllib

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.translate import load_car_file
from steerd.daemon.settings.car_edit import edit_car

DEFAULT = default_car_path().read_text()


def test_edits_keep_comments_and_order():
    text = edit_car(
        load_car(default_car_path()),
        {
            ("mocap", "marker_rear_x"): 0.21,
            ("vesc", "erpm_gain"): 4300.0,
            ("vesc", "uuid"): "ab" * 12,
        },
    ).text
    old, new = DEFAULT.splitlines(), text.splitlines()
    kept = [line for line in new if "uuid" not in line]
    changed = [(a, b) for a, b in zip(old, kept, strict=True) if a != b]
    assert [b.split("=")[0].strip() for _, b in changed] == ["erpm_gain", "marker_rear_x"]
    assert all(a.split("#")[1] == b.split("#")[1] for a, b in changed)
    assert tomllib.loads(text)["vesc"]["uuid"] == "ab" * 12


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (("vesc", "servo_gain"), 0.0, "servo_gain must not be zero"),
        (("mocap", "marker_raer"), 0.0, "marker_raer"),
        (("car", "mass"), -1.0, r"car\.mass"),
    ],
)
def test_edits_with_an_invalid_result_are_refused(key, value, said):
    with pytest.raises(SteerdError, match=said):
        edit_car(load_car(default_car_path()), {key: value})


def test_a_file_that_cannot_be_read_or_is_invalid_is_refused(tmp_path):
    with pytest.raises(SteerdError):
        load_car_file(tmp_path / "none.toml")
    path = tmp_path / "car.toml"
    path.write_text("[car]\nmass = -1.0\n")
    with pytest.raises(SteerdError):
        load_car_file(path)
