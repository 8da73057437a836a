"""A car file that began as F1TENTH's gets the wiring of the drives that it was learnt from."""

import tomllib
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path, load_car, parse_car
from steerd.daemon.analysis.wiring import find_wiring, with_wiring
from steerd.steer_bus.session import AttachedFile, SessionWriter

BASE = load_car(default_car_path())
OWN = BASE.text.replace("erpm_gain = 4614.0", "erpm_gain = -7300.0").replace('up = "y"', 'up = "z"')


@pytest.fixture
def drive(tmp_path):
    """Writes a drive with its car file, or with what an import was given about its motor."""

    def write(name, car_text=None, scaling=None):
        path = tmp_path / f"{name}.mcap"
        files = (
            [AttachedFile("car.toml", "application/toml", car_text.encode())] if car_text else []
        )
        metadata = {"steerd.session": {}, **({"steerd.scaling": scaling} if scaling else {})}
        SessionWriter(path, {}, metadata, files).finish({"reason": "end"})
        return path

    return write


def test_the_drives_own_motor_and_mocap_stand_in_the_file(drive):
    text = with_wiring(BASE.text, BASE, [drive("a", OWN), drive("b", OWN)])
    made = tomllib.loads(text)
    assert made["vesc"]["erpm_gain"] == -7300.0
    assert made["mocap"]["up"] == "z"
    assert made["car"] == tomllib.loads(BASE.text)["car"]


def test_what_an_import_was_given_stands_in_the_file(drive):
    path = drive("a", scaling={"erpm_gain": "-7350.0", "erpm_offset": "0.0"})
    assert find_wiring(BASE, [path]) == {("vesc", "erpm_gain"): -7350.0}


@pytest.mark.parametrize("case", ["default", "named", "differ", "gone"])
def test_nothing_changes_without_a_wiring_that_all_drives_share(drive, tmp_path, case):
    base, paths = BASE, [drive("a", OWN)]
    if case == "default":
        paths = [drive("b", BASE.text)]
    elif case == "named":
        base = parse_car(BASE.text, Path("mine.toml"))
    elif case == "differ":
        paths.append(drive("b", BASE.text))
    else:
        paths = [tmp_path / "gone.mcap"]
    assert find_wiring(base, paths) == {}
    assert with_wiring(BASE.text, base, paths) == BASE.text


def test_a_wiring_that_no_file_may_hold_loses_no_result(drive):
    wrong = OWN.replace("[vesc]", "[vesc]\nof_another_version = 1.0")
    assert with_wiring(BASE.text, BASE, [drive("a", wrong)]) == BASE.text
