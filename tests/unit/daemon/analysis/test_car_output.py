"""Car files that come out of an identification: digits, comments, wiring and noise."""

import tomllib
from math import inf
from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.car_file import Learned, default_car_path, load_car, parse_car
from steerd.daemon.analysis.car_output import find_wiring, learn_known, make_car
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session
from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.data.segments import SPEED_MIN, moving_segments
from steerd.sysid.inference.noise import Noise, noise_section

BASE = load_car(default_car_path())
FOUND = Learned(0.063010764350838, 0.000155127898, "steerd identify (ours): mixed.mcap")


def line(car, key):
    return next(each for each in car.text.splitlines() if each.startswith(f"{key} = "))


@pytest.mark.parametrize(("value", "sd", "shown"), [
    (15.2428916, 0.193184, 15.243), (9.668802290607, 6.69e-05, 9.6688023), (123.45678, 25.0, 123.5),
    (4.11234567, None, 4.11235), (4.11234567, 0.0, 4.11235), (4.11234567, inf, 4.11235),
])  # fmt: skip
def test_a_value_has_the_digits_that_its_error_leaves(value, sd, shown):
    """Rounding costs a two-hundredth of the error at most."""
    car = make_car(BASE, {"c_x": Learned(value, sd, "")}, Path("x.toml"))
    assert car.car.c_x == shown
    assert not sd or not sd < inf or abs(shown - value) <= sd / 200.0 + 1e-12


def test_comments_belong_to_the_values_that_stand_there():
    car = make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml"))
    assert "engineering estimate" in line(BASE, "steer_lag")
    said = "# s ± 0.00016, first-order lag of the servo, identify (ours)"
    assert line(car, "steer_lag").endswith(said)
    assert line(car, "speed_lag") == line(BASE, "speed_lag"), "what was not found stays as it was"
    old, new = tomllib.loads(BASE.text), tomllib.loads(car.text)
    assert {**old, "car": None} == {**new, "car": None}
    again = make_car(car, {"steer_lag": Learned(0.05, None, "given with --fix")}, car.path)
    assert line(again, "steer_lag").endswith("# s, first-order lag of the servo, given with --fix")


def test_an_effect_gets_its_comment_under_its_alias_too():
    text = BASE.text + "\n[effects.steer_delay]\ndelay = 0.02  # guessed\n"
    base = parse_car(text, Path("own.toml"))
    car = make_car(base, {"steer_delay.delay": Learned(0.05012345, 0.001, "x")}, base.path)
    assert "guessed" not in car.text
    assert car.values == (*BASE.values, (0.05012,))
    assert "± 0.001" in line(car, "delay")


def test_the_published_name_is_not_handed_on_and_a_name_of_ones_own_is():
    assert make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml")).name == "blue"
    mine = parse_car(BASE.text.replace(BASE.name, "The blue one"), Path("mine.toml"))
    assert make_car(mine, {"steer_lag": FOUND}, Path("blue.toml")).name == "The blue one"


# A car file that began as F1TENTH's gets the wiring of the drives that it was learnt from.
MINE = Path("mine.toml")
OWN = BASE.text.replace("erpm_gain = 4614.0", "erpm_gain = -7300.0").replace('up = "y"', 'up = "z"')


@pytest.fixture
def drive(tmp_path):
    """Writes a drive with its car file, or with what an import was given about its motor."""

    def write(name, car_text=None, scaling=None):
        path = tmp_path / f"{name}.mcap"
        files = {"car.toml": car_text.encode()} if car_text else {}
        metadata = {"steerd.session": {}, **({"steerd.scaling": scaling} if scaling else {})}
        SessionWriter(path, {}, metadata, files).finish({"reason": "end"})
        return open_session(path)

    return write


def test_the_drives_own_motor_and_mocap_or_what_an_import_was_given_stand_in_the_file(drive):
    wiring = find_wiring(BASE, [drive("a", OWN), drive("b", OWN)])
    made = tomllib.loads(make_car(BASE, {}, MINE, wiring).text)
    assert made["vesc"]["erpm_gain"] == -7300.0
    assert made["mocap"]["up"] == "z"
    assert made["car"] == tomllib.loads(BASE.text)["car"] | {"name": "mine"}
    session = drive("c", scaling={"erpm_gain": "-7350.0", "erpm_offset": "0.0"})
    assert find_wiring(BASE, [session]) == {("vesc", "erpm_gain"): -7350.0}


@pytest.mark.parametrize(("base", "texts"), [
    (BASE, [BASE.text]), (parse_car(BASE.text, MINE), [OWN]), (BASE, [OWN, BASE.text]),
    (BASE, [None]),
], ids=["default", "named", "differ", "none"])  # fmt: skip
def test_nothing_changes_without_a_wiring_that_all_drives_share(drive, base, texts):
    assert find_wiring(base, [drive(str(n), text) for n, text in enumerate(texts)]) == {}


def test_a_wiring_that_no_file_may_hold_loses_no_result(drive):
    wrong = OWN.replace("\n[vesc]", "\n[vesc]\nof_another_version = 1.0")
    wiring = find_wiring(BASE, [drive("a", wrong)])
    assert wiring
    assert make_car(BASE, {}, MINE, wiring).text == make_car(BASE, {}, MINE).text


# Noise is learnt where the car moves, as diagnose judges.
NOISE = Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))


def _straight(speed) -> Run:
    """20 s along x at speeds (2000,) [m/s]."""
    t = np.arange(2000) * 0.01
    pose = np.column_stack([np.cumsum(speed) * 0.01, np.zeros((2000, 2))])
    return make_run("straight", Signal(t, np.zeros(2000)), Signal(t, speed), Signal(t, pose))


def test_noise_is_learnt_where_the_car_moves(monkeypatch):
    seen = []
    monkeypatch.setattr(
        "steerd.daemon.analysis.car_output.learn_sections",
        lambda car, runs: (seen.extend(runs), {"noise": noise_section(NOISE)})[1],
    )
    assert learn_known(BASE, (_straight(np.full(2000, 0.5 * SPEED_MIN)),)) == {}
    run = _straight(np.repeat([0.0, 1.5], 1000))
    assert learn_known(BASE, (run,)) == {"noise": noise_section(NOISE)}
    assert [r.duration for r in seen] == [r.duration for r in moving_segments([run])]
    assert all(np.all(r.commands[:, 1] > SPEED_MIN) for r in seen)
    assert sum(r.duration for r in seen) < 10.0
