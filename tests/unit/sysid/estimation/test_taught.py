"""A taught car's rows: values, errors, and what is identifiable of it."""

import pytest

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.car_model.planar import make_planar
from steerd.sysid.estimation.taught import TaughtModel, taught_rows

CAR = DEFAULT_CAR._replace(lf=0.16, steer_gain=0.95)
MODEL = Model(CAR, (EFFECTS["tyre_saturation"],), ((0.8, 0.0),), make_planar("rear"))
SD = {"lf": 0.002, "lr": 0.1, "steer_gain": 0.01, "steer_delay": 0.001, "tyre_saturation.q": 0.1}


@pytest.fixture(scope="module")
def rows():
    return taught_rows(DEFAULT_CAR, TaughtModel(MODEL, SD))


def test_every_parameter_has_a_row_and_only_the_taught_ones_are_free(rows):
    car, effects = rows
    assert set(car) == {p.name for p in PARAMETERS}
    assert {name for name, row in car.items() if row.free} == {n for n in SD if "." not in n}
    assert set(effects) == {"tyre_saturation.q"}
    assert car["mass"].sd is None


def test_values_and_errors_are_the_teachers_and_the_start_is_the_given_car(rows):
    car, effects = rows
    assert car["lf"][:3] == (0.16, DEFAULT_CAR.lf, 0.002)
    assert effects["tyre_saturation.q"][:3] == (0.8, 0.0, 0.1)


def test_identifiable_is_what_is_known_to_a_few_percent(rows):
    car, _ = rows
    assert car["lf"].identifiable
    assert car["lf"].manoeuvre == ""
    assert not car["lr"].identifiable  # 0.1 m of 0.17 m
    assert "speeds" in car["lr"].manoeuvre
    assert car["steer_delay"].identifiable


def test_what_drives_mistake_for_the_bodys_place_is_to_be_weighed():
    offset = (EFFECTS["tyre_saturation"], EFFECTS["marker_offset"])
    model = Model(CAR, offset, ((0.8, 0.0), (0.02, 0.0)), make_planar("rear"))
    sd = {**SD, "lf": 0.02, "marker_offset.forward": 0.02}
    car, effects = taught_rows(DEFAULT_CAR, TaughtModel(model, sd))
    for row in (car["lf"], car["lr"], effects["marker_offset.forward"]):
        assert not row.identifiable
        assert "weighing both axles" in row.manoeuvre
    assert car["steer_gain"].manoeuvre == ""
