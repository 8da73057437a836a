"""The unrolled step is the model's own step, bit for bit, with every effect of the library."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from steerd.car_model import machine_code
from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import BaseSelection, Effect, Stage
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.rollout import start, step
from steerd.car_model.state import ORIGIN, Command
from steerd.sim_hw.plant.native import follow, generate
from steerd.sim_hw.plant.unrolled import make_steps

H = 0.002
needs_compiler = pytest.mark.skipif(not machine_code.find_compiler(), reason="no C compiler")


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


@pytest.fixture
def compiled() -> Iterator[None]:
    """The machine code is there; steps are made anew."""
    assert machine_code.build_library(follow.PLANT) is not None
    follow._library.cache_clear()
    make_steps.cache_clear()
    assert follow._library() is not None
    yield
    make_steps.cache_clear()


@pytest.fixture
def without_compiler(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No machine code: Python alone."""
    monkeypatch.setattr(follow, "_library", lambda: None)
    make_steps.cache_clear()
    yield
    make_steps.cache_clear()


def test_plain_car_is_unrolled_and_equal(without_compiler: None) -> None:
    model = Model(DEFAULT_CAR)
    assert make_steps(model).unrolled
    drive(model, seed=1, steps=1000)


@needs_compiler
@pytest.mark.parametrize(
    "chassis", generate.CHASSIS, ids=lambda chassis: follow.function_name("of", chassis)
)
def test_machine_code_of_every_chassis_is_equal(compiled: None, chassis: Chassis) -> None:
    car = PAPER_CAR._replace(steer_gain=0.9, steer_bias=0.02, speed_gain=1.07)
    for seed, each in enumerate((DEFAULT_CAR, car)):
        drive(Model(each, chassis=chassis), seed=seed, steps=500)


@needs_compiler
def test_effects_outside_the_step_keep_it_in_machine_code(compiled: None) -> None:
    late, inside = (EFFECTS[name] for name in ("steer_delay", "tyre_friction"))
    model = Model(DEFAULT_CAR, (late,), ((0.03,),))
    assert follow.make_native(model, "glide", lambda: ()) is not None
    assert follow.make_native(Model(DEFAULT_CAR, (inside,), ((0.9,),)), "glide", lambda: ()) is None
    drive(model, seed=5)


@needs_compiler
def test_what_is_not_finite_is_left_to_python(compiled: None) -> None:
    steps = make_steps(Model(DEFAULT_CAR))
    with pytest.raises((OverflowError, ValueError)):
        steps.follow(0.0, 0.0, math.inf, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, H)


def test_the_printed_steps_are_those_of_the_equations() -> None:
    assert generate.TARGET.read_text(encoding="utf-8") == generate.generated_text()


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
