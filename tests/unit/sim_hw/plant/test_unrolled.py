"""The unrolled step is the model's own step, bit for bit, with every effect of the library."""

import numpy as np
import pytest

from steerd.car_model.effect import BaseSelection, Effect, Stage
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.rollout import start, step
from steerd.car_model.state import ORIGIN, Command
from steerd.sim_hw.plant.unrolled import make_steps

H = 0.002


def drive(model: Model[float], seed: int, steps: int = 150) -> None:
    rng = np.random.default_rng(seed)
    unrolled = make_steps(model)
    moment = start(model, ORIGIN._replace(speed=0.1), 0.0)
    numbers: tuple[float, ...] = (*moment.state, *moment.memory)
    for k in range(steps):
        command = Command(*rng.uniform((-0.5, -1.0), (0.5, 4.0)).tolist())
        moment = step(FLOAT, model, moment, command, k * H, H)
        end = unrolled.actuate(*numbers, *command, k * H, H)
        both = unrolled.follow(*numbers, *command, k * H, H)
        numbers = unrolled.glide(*numbers, *end, k * H, H)
        assert both == numbers
        assert repr(numbers) == repr((*moment.state, *moment.memory))  # -0.0 is not 0.0


def test_plain_car_is_unrolled_and_equal() -> None:
    model = Model(DEFAULT_CAR)
    assert make_steps(model).unrolled
    drive(model, seed=1, steps=1000)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_is_unrolled_and_equal(name: str) -> None:
    effect = EFFECTS[name]
    values = tuple(min(max(p.null + 0.7 * p.scale, p.low), p.high) for p in effect.parameters)
    model = Model(DEFAULT_CAR, (effect,), (values,))
    assert make_steps(model).unrolled
    drive(model, seed=2)


def branching(ops, p, ref, t):  # type: ignore[no-untyped-def]
    return ref._replace(steer=ref.steer + 0.01) if ref.speed > 1.0 else ref


def test_a_model_that_branches_on_values_runs_as_it_is() -> None:
    effect = Effect(
        name="branching",
        stage=Stage.COMMAND,
        family="steering",
        summary="",
        equation="",
        parameters=(),
        least_size=0.0,
        confounded_with=None,
        needs_commands=None,
        selectable_in_base=BaseSelection.NEVER,
        zero_gradient=False,
        reference=branching,
    )
    model = Model(DEFAULT_CAR, (effect,), ((),))
    assert not make_steps(model).unrolled
    drive(model, seed=3)


def test_two_effects_with_memory_together() -> None:
    both = (EFFECTS["steer_backlash"], EFFECTS["tyre_relaxation"])
    values = tuple(tuple(p.null + 0.5 * p.scale for p in e.parameters) for e in both)
    drive(Model(DEFAULT_CAR, both, values), seed=4)
