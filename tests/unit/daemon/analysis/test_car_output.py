"""Car files that come out of an identification: digits, comments and names that are true."""

import tomllib
from math import inf
from pathlib import Path

import pytest

from steerd.car_model.car_file import Learned, default_car_path, load_car, parse_car
from steerd.daemon.analysis.car_output import make_car

BASE = load_car(default_car_path())
FOUND = Learned(0.063010764350838, 0.000155127898, "steerd identify (ours): mixed.mcap")


def line(car, key):
    return next(each for each in car.text.splitlines() if each.startswith(f"{key} = "))


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [(15.2428916, 0.193184, 15.243), (9.668802290607, 6.69e-05, 9.6688023),
     (123.45678, 25.0, 123.5), (4.11234567, None, 4.11235), (4.11234567, 0.0, 4.11235),
     (4.11234567, inf, 4.11235)],
)  # fmt: skip
def test_a_value_has_the_digits_that_its_error_leaves(value, sd, shown):
    """Rounding costs a two-hundredth of the error at most."""
    car = make_car(BASE, {"c_x": Learned(value, sd, "")}, Path("x.toml"))
    assert car.car.c_x == shown
    assert not sd or not sd < inf or abs(shown - value) <= sd / 200.0 + 1e-12


def test_comments_belong_to_the_values_that_stand_there():
    car = make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml"))
    assert "engineering estimate" in line(BASE, "steer_lag")
    assert line(car, "steer_lag").endswith(
        "# s ± 0.00016, first-order lag of the servo, identify (ours)"
    )
    assert line(car, "speed_lag") == line(BASE, "speed_lag"), "what was not found stays as it was"
    again = make_car(car, {"steer_lag": Learned(0.05, None, "given with --fix")}, car.path)
    assert line(again, "steer_lag").endswith("# s, first-order lag of the servo, given with --fix")


def test_an_effect_gets_its_comment_under_its_alias_too():
    text = BASE.text + "\n[effects.steer_delay]\ndelay = 0.02  # guessed\n"
    base = parse_car(text, Path("own.toml"))
    car = make_car(base, {"steer_delay.delay": Learned(0.05012345, 0.001, "x")}, base.path)
    assert "guessed" not in car.text
    assert car.values == ((0.05012,),)
    assert "± 0.001" in line(car, "delay")


def test_the_published_name_is_not_handed_on_and_a_name_of_ones_own_is():
    assert make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml")).name == "blue"
    mine = parse_car(BASE.text.replace(BASE.name, "The blue one"), Path("mine.toml"))
    assert make_car(mine, {"steer_lag": FOUND}, Path("blue.toml")).name == "The blue one"


def test_the_file_is_a_right_car_file_with_everything_else_as_it_was():
    car = make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml"))
    old, new = tomllib.loads(BASE.text), tomllib.loads(car.text)
    assert {k: v for k, v in old.items() if k != "car"} == {
        k: v for k, v in new.items() if k != "car"
    }
