"""The compiled step is the model's own step on floats, with every effect of the library."""

import math

import numpy as np
import pytest

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect, Stage
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import STATES
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.planar import CHASSIS, PLANAR
from steerd.car_model.rollout import start, step
from steerd.car_model.state import ORIGIN, Command
from steerd.sim_hw.plant.car import make_steps

H = 0.002
CROOKED = PAPER_CAR._replace(steer_gain=0.9, steer_bias=0.02, speed_gain=1.07)


def assert_driven_alike(model: Model[float], count: int) -> None:
    """By the states, which are all that shows: memory is laid out otherwise in the library."""
    rng = np.random.default_rng(2)
    steps, begun = make_steps(model, H), ORIGIN._replace(speed=0.1)
    numbers, moment = (*begun, *[0.0] * steps.memory), start(model, begun, 0.0)
    for k in range(count):
        order = Command(*rng.uniform((-0.5, -1.0), (0.5, 4.0)).tolist())
        numbers = steps.follow(*numbers, *order, k * H)
        moment = step(FLOAT, model, moment, order, k * H, H)
        np.testing.assert_allclose(numbers[:STATES], moment.state, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
@pytest.mark.parametrize("car", [DEFAULT_CAR, CROOKED], ids=["straight", "crooked"])
def test_every_chassis_is_equal(chassis: Chassis, car) -> None:
    assert_driven_alike(Model(car, chassis=chassis), 500)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_is_equal(name: str) -> None:
    effect = EFFECTS[name]
    values = tuple(min(max(p.null + 0.7 * p.scale, p.low), p.high) for p in effect.parameters)
    assert_driven_alike(Model(DEFAULT_CAR, (effect,), (values,)), 150)


def test_a_step_is_its_two_halves_and_a_glide_its_parts() -> None:
    whole, half = (make_steps(Model(DEFAULT_CAR, chassis=PLANAR), h) for h in (H, H / 2.0))
    begun, order = (*ORIGIN._replace(speed=1.0, steer=0.05), *[0.0] * whole.memory), (0.2, 1.5, 0.0)
    end, accel = whole.actuate(*begun, *order)
    assert whole.glide(1, *begun, end, accel, 0.0) == whole.follow(*begun, *order)
    middle = half.glide(1, *begun, 0.5 * (0.05 + end), accel, 0.0)
    parts = half.glide(1, *middle, end, accel, 0.5 * H)
    assert whole.glide(2, *begun, end, accel, 0.0) == pytest.approx(parts, rel=1e-12)


def test_what_is_not_finite_is_an_error() -> None:
    steps = make_steps(Model(DEFAULT_CAR), H)
    with pytest.raises(ValueError, match="no number"):
        steps.follow(0.0, 0.0, math.inf, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)


def test_an_effect_that_is_not_the_librarys_is_refused() -> None:
    effect = Effect("own", Stage.COMMAND, "steering", "", "", (), least_size=0.0)
    with pytest.raises(ValueError, match="without own"):
        make_steps(Model(DEFAULT_CAR, (effect,), ((),)), H)
