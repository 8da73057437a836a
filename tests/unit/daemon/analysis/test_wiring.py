"""A car file that began as F1TENTH's gets the wiring of the drives that it was learnt from."""

import tomllib
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path, load_car, parse_car
from steerd.daemon.analysis.car_output import find_wiring, make_car
from steerd.steer_bus.session import AttachedFile, SessionWriter, open_session

BASE = load_car(default_car_path())
MINE = Path("mine.toml")
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
        return open_session(path)

    return write


def test_the_drives_own_motor_and_mocap_stand_in_the_file(drive):
    wiring = find_wiring(BASE, [drive("a", OWN), drive("b", OWN)])
    made = tomllib.loads(make_car(BASE, {}, MINE, wiring).text)
    assert made["vesc"]["erpm_gain"] == -7300.0
    assert made["mocap"]["up"] == "z"
    assert made["car"] == tomllib.loads(BASE.text)["car"] | {"name": "mine"}


def test_what_an_import_was_given_stands_in_the_file(drive):
    session = drive("a", scaling={"erpm_gain": "-7350.0", "erpm_offset": "0.0"})
    assert find_wiring(BASE, [session]) == {("vesc", "erpm_gain"): -7350.0}


@pytest.mark.parametrize("case", ["default", "named", "differ", "none"])
def test_nothing_changes_without_a_wiring_that_all_drives_share(drive, case):
    base, sessions = BASE, [drive("a", OWN)]
    if case == "default":
        sessions = [drive("b", BASE.text)]
    elif case == "named":
        base = parse_car(BASE.text, MINE)
    elif case == "differ":
        sessions.append(drive("b", BASE.text))
    else:
        sessions = [drive("c")]
    assert find_wiring(base, sessions) == {}


def test_a_wiring_that_no_file_may_hold_loses_no_result(drive):
    wrong = OWN.replace("\n[vesc]", "\n[vesc]\nof_another_version = 1.0")
    wiring = find_wiring(BASE, [drive("a", wrong)])
    assert wiring
    assert make_car(BASE, {}, MINE, wiring).text == make_car(BASE, {}, MINE).text
