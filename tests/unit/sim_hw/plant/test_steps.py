"""The compiled step is the model's own step on floats, with every effect of the library."""

import math

import numpy as np
import pytest

from steerd.car_model.actuators import actuate
from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect, Stage
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model, Moment, aim, car_now, memory_size
from steerd.car_model.native.windows import STATES
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.planar import CHASSIS
from steerd.car_model.rollout import glide, step
from steerd.car_model.state import ORIGIN, Command, State
from steerd.sim_hw.plant.car import Numbers, Steps, make_steps

H = 0.002


def plain_steps(model: Model[float], h: float) -> Steps:
    """The model's own steps on floats."""
    memory = memory_size(model.effects)

    def split(numbers: Numbers) -> tuple[Moment[float], Numbers]:
        return Moment(State(*numbers[:STATES]), numbers[STATES:-3]), numbers[-3:]

    def follow_floats(*numbers: float) -> Numbers:
        moment, (steer, speed, t) = split(numbers)
        after = step(FLOAT, model, moment, Command(steer, speed), t, h)
        return (*after.state, *after.memory)

    def actuate_floats(*numbers: float) -> Numbers:
        moment, (steer, speed, t) = split(numbers)
        car = car_now(FLOAT, model, moment.state, t)
        ref = aim(FLOAT, model, car, Command(steer, speed), t)
        return tuple(actuate(FLOAT, car, moment.state, ref, h))

    def glide_floats(count: int, *numbers: float) -> Numbers:
        moment, (end, accel, t) = split(numbers)
        begun, part = moment.state.steer, h / count
        for i in range(count):
            steer = begun + (end - begun) * (i + 1) / count
            moment = glide(FLOAT, model, moment, steer, accel, t + i * part, part)
        return (*moment.state, *moment.memory)

    return Steps(memory, follow_floats, actuate_floats, glide_floats)


def drive(model: Model[float], seed: int, steps: int = 150) -> None:
    """The state, which is all that shows: memory is laid out otherwise in the library."""
    rng = np.random.default_rng(seed)
    both = make_steps(model, H), plain_steps(model, H)
    numbers = [(*ORIGIN._replace(speed=0.1), *[0.0] * each.memory) for each in both]
    for k in range(steps):
        given = (*rng.uniform((-0.5, -1.0), (0.5, 4.0)).tolist(), k * H)
        ends = [s.actuate(*x, *given) for s, x in zip(both, numbers, strict=True)]
        np.testing.assert_allclose(*ends, rtol=1e-12, atol=1e-12)
        if k % 3:
            numbers = [s.follow(*x, *given) for s, x in zip(both, numbers, strict=True)]
        else:
            given = (*ends[0], k * H)
            numbers = [s.glide(1 + k % 4, *x, *given) for s, x in zip(both, numbers, strict=True)]
        np.testing.assert_allclose(*(x[:7] for x in numbers), rtol=1e-11, atol=1e-12)


def test_a_step_is_its_two_halves() -> None:
    steps = make_steps(Model(DEFAULT_CAR), H)
    numbers = (*ORIGIN._replace(speed=1.0), 0.2, 1.5, 0.0)
    whole = steps.follow(*numbers)
    assert steps.glide(1, *numbers[:7], *steps.actuate(*numbers), 0.0) == whole


@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
def test_every_chassis_is_equal(chassis: Chassis) -> None:
    car = PAPER_CAR._replace(steer_gain=0.9, steer_bias=0.02, speed_gain=1.07)
    for seed, each in enumerate((DEFAULT_CAR, car)):
        drive(Model(each, chassis=chassis), seed=seed, steps=500)


def test_what_is_not_finite_is_an_error() -> None:
    steps = make_steps(Model(DEFAULT_CAR), H)
    with pytest.raises(ValueError, match="no number"):
        steps.follow(0.0, 0.0, math.inf, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_is_equal(name: str) -> None:
    effect = EFFECTS[name]
    values = tuple(min(max(p.null + 0.7 * p.scale, p.low), p.high) for p in effect.parameters)
    drive(Model(DEFAULT_CAR, (effect,), (values,)), seed=2)


def test_an_effect_that_is_not_the_librarys_is_refused() -> None:
    effect = Effect("own", Stage.COMMAND, "steering", "", "", (), least_size=0.0)
    with pytest.raises(ValueError, match="without own"):
        make_steps(Model(DEFAULT_CAR, (effect,), ((),)), H)
