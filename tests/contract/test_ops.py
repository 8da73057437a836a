"""One set of equations over every number type: floats, arrays, tensors and formulas agree."""

import math
from typing import Any

import numpy as np
import pytest
import sympy
import torch

from car_model.numpy_ops import NUMPY
from car_model.ops import FLOAT
from car_model.params import DEFAULT_CAR, Car
from car_model.single_track import actuate, derivative
from car_model.state import Command, State
from car_model.symbolic import (
    SYMBOLIC,
    symbolic_actuated,
    symbolic_car,
    symbolic_rates,
    symbolic_state,
    symbols,
)

ONE = ("sin", "cos", "tan", "atan", "tanh", "exp", "absolute")
VALUES = (-1.3, -0.25, 0.0, 0.25, 1.3)


def kinds(torch_ops: Any) -> dict[str, tuple[Any, Any]]:
    """Each implementation with the way into its number type."""
    return {
        "numpy": (NUMPY, np.float64),
        "torch": (torch_ops, lambda v: torch.tensor(v, dtype=torch.float64)),
        "sympy": (SYMBOLIC, sympy.Float),
    }


@pytest.fixture(params=["numpy", "torch", "sympy"])
def kind(request: pytest.FixtureRequest, torch_ops: Any) -> tuple[Any, Any]:
    return kinds(torch_ops)[request.param]


@pytest.mark.parametrize("name", ONE)
def test_functions_of_one_number(kind: tuple[Any, Any], name: str) -> None:
    ops, number = kind
    for value in VALUES:
        found = float(getattr(ops, name)(number(value)))
        assert found == pytest.approx(getattr(FLOAT, name)(value), rel=1e-14, abs=1e-15)


def test_square_root(kind: tuple[Any, Any]) -> None:
    ops, number = kind
    assert float(ops.sqrt(number(2.25))) == pytest.approx(1.5, rel=1e-15)


def test_choices(kind: tuple[Any, Any]) -> None:
    ops, number = kind
    for a in VALUES:
        for b in VALUES:
            assert float(ops.minimum(number(a), b)) == min(a, b) == FLOAT.minimum(a, b)
            assert float(ops.maximum(number(a), b)) == max(a, b) == FLOAT.maximum(a, b)
        assert float(ops.clip(number(a), number(-0.5), 0.5)) == min(max(a, -0.5), 0.5)
        assert FLOAT.clip(a, -0.5, 0.5) == min(max(a, -0.5), 0.5)
        chosen = ops.where_positive(number(a), number(1.0), number(2.0))
        assert float(chosen) == (1.0 if a > 0.0 else 2.0) == FLOAT.where_positive(a, 1.0, 2.0)


def points(count: int) -> list[tuple[State[float], float, float]]:
    """States from crawling to fast, with wheel angle and acceleration."""
    rng = np.random.default_rng(4)
    spread = (3.0, 3.0, 2.0, 0.0, 1.0, 0.2, 0.2)
    return [
        (
            State(*rng.normal(0.0, spread).tolist())._replace(speed=float(rng.uniform(-0.5, 5.0))),
            float(rng.uniform(-0.4, 0.4)),
            float(rng.uniform(-4.0, 4.0)),
        )
        for _ in range(count)
    ]


def test_rates_agree(torch_ops: Any) -> None:
    for name, (ops, number) in kinds(torch_ops).items():
        for state, wheel, accel in points(3 if name == "sympy" else 20):
            car, at = Car(*map(number, DEFAULT_CAR)), State(*map(number, state))
            found = derivative(ops, car, at, number(wheel), number(accel))
            expected = derivative(FLOAT, DEFAULT_CAR, state, wheel, accel)
            assert [float(v) for v in found] == pytest.approx(list(expected), rel=1e-12, abs=1e-12)


def test_lanes_of_an_array_are_cars_of_their_own() -> None:
    drawn = points(16)
    lanes = State(*(np.array(v) for v in zip(*(s for s, _, _ in drawn), strict=True)))
    wheel, accel = (np.array([d[i] for d in drawn]) for i in (1, 2))
    found = derivative(NUMPY, DEFAULT_CAR, lanes, wheel, accel)
    for i, (state, one_wheel, one_accel) in enumerate(drawn):
        expected = derivative(FLOAT, DEFAULT_CAR, state, one_wheel, one_accel)
        assert [v[i] for v in found] == pytest.approx(list(expected), rel=1e-12, abs=1e-12)


def numbers_for(*groups: tuple[Any, Any]) -> dict[Any, float]:
    """Values for the symbols of (symbols, values) pairs."""
    return {
        name: value for names, values in groups for name, value in zip(names, values, strict=True)
    }


def test_formulas_evaluate_to_the_floats() -> None:
    rates, actuated = symbolic_rates(), symbolic_actuated()
    inputs, aims = symbols("wheel", "accel"), symbols("ref_steer", "ref_speed", "h")
    for state, wheel, accel in points(4):
        known = (symbolic_car(), DEFAULT_CAR), (symbolic_state(), state)
        at = numbers_for(*known, (inputs, (wheel, accel)))
        expected = derivative(FLOAT, DEFAULT_CAR, state, wheel, accel)
        assert [float(r.subs(at)) for r in rates] == pytest.approx(list(expected), rel=1e-11)
        aim = Command(0.3, 2.0)
        at = numbers_for(*known, (aims, (*aim, 0.01)))
        moved = actuate(FLOAT, DEFAULT_CAR, state, aim, 0.01)
        assert [float(a.subs(at)) for a in actuated] == pytest.approx(list(moved), rel=1e-11)


def test_a_formula_has_the_derivative_of_the_branch_taken() -> None:
    (x,) = symbols("x")
    clipped = sympy.diff(SYMBOLIC.clip(x * x, 0.0, 4.0), x)
    assert float(clipped.subs(x, 1.5)) == pytest.approx(3.0)
    assert float(clipped.subs(x, 2.5)) == 0.0
    assert math.isclose(float(sympy.diff(SYMBOLIC.absolute(x), x).subs(x, -2.0)), -1.0)
