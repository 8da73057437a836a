"""Car files that come out of an identification: digits, comments and names that are true."""

import tomllib
from math import inf, nan
from pathlib import Path

import pytest

from steerd.car_model.car_file import Learned, default_car_path, load_car, parse_car
from steerd.daemon.analysis.car_output import make_car

BASE = load_car(default_car_path())
FOUND = Learned(0.063010764350838, 0.000155127898, "steerd identify (ours): mixed.mcap")


def line(car, key):
    return next(each for each in car.text.splitlines() if each.startswith(f"{key} = "))


def test_a_value_has_the_digits_that_its_error_leaves():
    car = make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml"))
    assert car.car.steer_lag == 0.063011
    assert car.sd["steer_lag"] == 0.00016


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [(15.2428916, 0.193184, 15.243), (0.9668802290607, 6.69e-06, 0.96688023),
     (1234.5678, 250.0, 1235.0), (0.0411234567, None, 0.0411235), (0.0411234567, 0.0, 0.0411235),
     (0.0411234567, nan, 0.0411235), (0.0411234567, inf, 0.0411235)],
)  # fmt: skip
def test_rounding_costs_a_two_hundredth_of_the_error_at_most(value, sd, shown):
    car = BASE.car._replace(c_x=value)
    learned = Learned(value if 2.0 <= value <= 200.0 else 15.0, None, "")
    assert make_car(BASE, {"c_x": learned}, Path("x.toml")).car.c_x == pytest.approx(learned.value)
    from steerd.daemon.analysis.car_output import _rounded

    assert _rounded(Learned(car.c_x, sd)).value == shown
    if sd and sd < inf:
        assert abs(shown - value) <= sd / 200.0 + 1e-12


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
