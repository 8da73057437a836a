"""Effects that are changes of parameters reach designs; without effects nothing changes."""

import pytest

from steerd.car_model.effects import EFFECTS, parse_effects
from steerd.car_model.model import Model
from steerd.car_model.nominal_car import believed_car
from steerd.car_model.params import DEFAULT_CAR, wheelbase


def believed(text):
    chosen = parse_effects(text)
    return believed_car(
        Model(DEFAULT_CAR, tuple(e for e, _ in chosen), tuple(v for _, v in chosen))
    )


def test_no_effect_changes_nothing():
    assert believed_car(Model(DEFAULT_CAR)) == DEFAULT_CAR


@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_null_no_effect_changes_anything(name):
    effect = EFFECTS[name]
    assert believed_car(Model(DEFAULT_CAR, (effect,), (effect.nulls,))) == DEFAULT_CAR


def test_dead_times_add_up():
    car = believed("steer_delay=0.05,drive_delay=0.02,mocap_latency=0.01")
    assert car.steer_delay == pytest.approx(DEFAULT_CAR.steer_delay + 0.05)
    assert car.drive_delay == pytest.approx(DEFAULT_CAR.drive_delay + 0.02)
    assert car.pose_delay == pytest.approx(DEFAULT_CAR.pose_delay + 0.01)


def test_parameters_become_what_the_effects_make_them():
    car = believed("steer_lag=0.04,steer_gain=0.9,cog_offset=0.02")
    assert car.steer_lag == pytest.approx(DEFAULT_CAR.steer_lag + 0.04)
    assert car.steer_gain == pytest.approx(0.9 * DEFAULT_CAR.steer_gain)
    assert car.lr == pytest.approx(DEFAULT_CAR.lr + 0.02)
    assert wheelbase(car) == pytest.approx(wheelbase(DEFAULT_CAR))


def test_a_slippery_patch_is_not_the_whole_floor():
    assert believed("grip_patch:x=0,y=0,radius=3,drop=0.4").mu == pytest.approx(DEFAULT_CAR.mu)
