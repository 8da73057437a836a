"""Every effect: nothing at its null, bounds, gradients; the operations over every number type."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.torch_reference import TORCH
from steerd.car_model.effect import Effect, Role
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model, delays, observe
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.rollout import simulate, start
from steerd.car_model.state import Command, State

STEP = 0.01
SHORT = 15  # steps of a run over scalar tensors, which are slow one by one
EVERY = [pytest.param(effect, id=name) for name, effect in EFFECTS.items()]


def make_drive(seed: int, steps: int) -> tuple[State[float], list[Command[float]]]:
    """A lively start state near (2, 2), and commands that change often, down to standstill."""
    rng = np.random.default_rng(seed)
    spread = (0.3, 0.3, 1.0, 0.0, 0.5, 0.05, 0.1)
    first = State(*rng.normal((2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0), spread).tolist())
    first = first._replace(speed=float(rng.uniform(0.0, 4.0)))
    held = rng.integers(3, 12)
    draws = rng.uniform((-0.45, -0.2), (0.45, 4.0), ((steps // held + 1) * held, 2))
    return first, [Command(*draw) for draw in draws[:steps].tolist()]


def drive(ops: Any, model: Model[Any], seed: int, number: Any, steps: int = 60) -> list[Any]:
    """Every number that a run shows: states, observations, delays."""
    first, commands = make_drive(seed, steps)
    zero = number(0.0)
    moments = simulate(
        ops, model, start(model, State(*map(number, first)), zero),
        [Command(*map(number, c)) for c in commands], STEP,
    )  # fmt: skip
    seen = [observe(ops, model, m.state) for m in moments]
    shown = (*(m.state for m in moments), *seen, delays(model))
    return [value for each in shown for value in each]


def tensor(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


def ordinary(effect: Effect) -> tuple[float, ...]:
    """A severity that is ordinary on such a car, within bounds."""
    return tuple(
        p.scan[len(p.scan) // 3] if p.scan else min(p.null + p.scale, 0.5 * (p.null + p.high))
        for p in effect.parameters
    )


@cache
def drive_floats(seed: int, *given: tuple[Effect, tuple[float, ...]]) -> list[float]:
    effects, values = zip(*given, strict=True) if given else ((), ())
    return drive(FLOAT, Model(DEFAULT_CAR, effects, values), seed, float)


@pytest.mark.parametrize("effect", EVERY)
def test_the_null_changes_no_bit_and_other_values_a_run_that_stays_finite(effect: Effect) -> None:
    for seed in range(6):
        assert drive_floats(seed, (effect, effect.nulls)) == drive_floats(seed)
    for seed in range(4):
        run = drive_floats(seed, (effect, ordinary(effect)))
        assert run != drive_floats(seed)
        assert all(map(math.isfinite, run))
    for values in zip(*((p.low, p.high) for p in effect.parameters), strict=True):
        assert all(map(math.isfinite, drive_floats(3, (effect, values))))


@pytest.mark.parametrize("effect", EVERY)
def test_bounds_hold_the_null_and_what_the_diagnosis_knows_fits_together(effect: Effect) -> None:
    assert effect.parameters
    for p in effect.parameters:
        assert all(map(math.isfinite, (p.null, p.low, p.high, p.scale)))
        assert p.low < p.high
        assert all(p.low <= value <= p.high for value in (p.null, *p.scan))
        assert p.scale > 0.0
        assert p.unit
        assert p.meaning
    others = effect.confounded_with.effects if effect.confounded_with else ()
    assert effect.name not in others
    assert set(others) <= set(EFFECTS)
    assert effect.changes or (effect.in_base and effect.on_every_car)
    assert effect.least_size >= 0.0
    assert any(p.role is Role.SIZE for p in effect.parameters)
    assert effect.size(effect.nulls, effect.nulls) == 0.0
    assert effect.size(ordinary(effect), effect.nulls) > 0.0


def score(run: list[Any]) -> Any:
    """One number that every state, observation and delay moves."""
    weights = [math.sin(0.1 + 1.7 * i) for i in range(len(run))]
    return sum(w * value for w, value in zip(weights, run, strict=True))


def gradient(effect: Effect, at: tuple[float, ...], seed: int) -> list[float]:
    values = tuple(tensor(v).requires_grad_() for v in at)
    model = Model(Car(*map(tensor, DEFAULT_CAR)), (effect,), (values,))
    total = score(drive(TORCH, model, seed, tensor, SHORT))
    return [float(g) for g in torch.autograd.grad(total, values)]


@pytest.mark.parametrize("effect", EVERY)
def test_gradients_at_and_beside_the_null_are_finite(effect: Effect) -> None:
    for share in (-1e-4, 0.0, 1e-4):
        at = tuple(p.null + share * p.scale for p in effect.parameters)
        found = gradient(effect, at, 2)
        assert all(map(math.isfinite, found))
        if not effect.zero_gradient:
            named = zip(effect.parameters, found, strict=True)
            acting = [g for p, g in named if p.role is Role.SIZE]
            assert all(acting), "it needs a scan: no gradient at the null says where to go"


# One set of operations over every number type: floats and arrays agree.
VALUES = (-1.3, -0.25, 0.0, 0.25, 1.3)
CHOICES = {
    "square root": lambda ops, a, b: ops.sqrt(1.25 + a),
    "minimum": lambda ops, a, b: ops.minimum(a, b),
    "maximum": lambda ops, a, b: ops.maximum(a, b),
    "clip": lambda ops, a, b: ops.clip(a, -0.5 + 0.0 * b, 0.5),
    "where positive": lambda ops, a, b: ops.where_positive(a, 1.0 + b, 2.0),
    **{name: (lambda ops, a, b, name=name: getattr(ops, name)(a))
       for name in ("sin", "cos", "tan", "atan", "tanh", "exp", "absolute")},
}  # fmt: skip
"""The operations of one or two numbers; the tape's: tests/unit/car_model/test_tape.py."""


@pytest.mark.parametrize("function", CHOICES.values(), ids=CHOICES)
def test_an_array_gives_what_each_of_its_numbers_gives(function):
    a, b = map(np.ravel, np.meshgrid(VALUES[1:], VALUES))
    alone = [function(FLOAT, float(x), float(y)) for x, y in zip(a, b, strict=True)]
    assert function(NUMPY, a, b) == pytest.approx(alone, rel=1e-14, abs=1e-15)


def test_choices_of_floats():
    assert (FLOAT.minimum(1.0, 2.0), FLOAT.maximum(1.0, 2.0)) == (1.0, 2.0)
    assert [FLOAT.clip(a, -0.5, 0.5) for a in VALUES] == [-0.5, -0.25, 0.0, 0.25, 0.5]
    assert [FLOAT.where_positive(a, 1.0, 2.0) for a in VALUES] == [2.0, 2.0, 2.0, 1.0, 1.0]
