"""One set of equations over every number type: floats, arrays and records agree."""

from typing import Any

import numpy as np
import pytest

from steerd.car_model.chassis import derivative
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import State
from steerd.car_model.tape import TAPE, Node, Tape

ONE = ("sin", "cos", "tan", "atan", "tanh", "exp", "absolute")
VALUES = (-1.3, -0.25, 0.0, 0.25, 1.3)


KINDS = {"numpy": (NUMPY, np.float64), "tape": (TAPE, Tape().constant)}
"""Each implementation with the way into its number type."""


def value(number: Any) -> float:
    """The number alone; operations on constants are recorded as their results."""
    return number.entry.value if isinstance(number, Node) else float(number)


@pytest.fixture(params=KINDS.values(), ids=KINDS)
def kind(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    pair: tuple[Any, Any] = request.param
    return pair


@pytest.mark.parametrize("name", ONE)
def test_functions_of_one_number(kind, name):
    ops, number = kind
    for a in VALUES:
        found = value(getattr(ops, name)(number(a)))
        assert found == pytest.approx(getattr(FLOAT, name)(a), rel=1e-14, abs=1e-15)


def test_square_root(kind):
    ops, number = kind
    assert value(ops.sqrt(number(2.25))) == pytest.approx(1.5, rel=1e-15)


def test_choices(kind):
    ops, number = kind
    for a in VALUES:
        for b in VALUES:
            assert value(ops.minimum(number(a), b)) == min(a, b) == FLOAT.minimum(a, b)
            assert value(ops.maximum(number(a), b)) == max(a, b) == FLOAT.maximum(a, b)
        assert value(ops.clip(number(a), number(-0.5), 0.5)) == min(max(a, -0.5), 0.5)
        assert FLOAT.clip(a, -0.5, 0.5) == min(max(a, -0.5), 0.5)
        chosen = ops.where_positive(number(a), number(1.0), number(2.0))
        assert value(chosen) == (1.0 if a > 0.0 else 2.0) == FLOAT.where_positive(a, 1.0, 2.0)


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


def test_rates_agree(kind):
    ops, number = kind
    for state, wheel, accel in points(20):
        car, at = Car(*map(number, DEFAULT_CAR)), State(*map(number, state))
        found = derivative(SINGLE_TRACK, ops, car, at, number(wheel), number(accel))
        expected = derivative(SINGLE_TRACK, FLOAT, DEFAULT_CAR, state, wheel, accel)
        assert [value(v) for v in found] == pytest.approx(list(expected), rel=1e-12, abs=1e-12)


def test_lanes_of_an_array_are_cars_of_their_own():
    drawn = points(16)
    lanes = State(*(np.array(v) for v in zip(*(s for s, _, _ in drawn), strict=True)))
    wheel, accel = (np.array([d[i] for d in drawn]) for i in (1, 2))
    found = derivative(SINGLE_TRACK, NUMPY, DEFAULT_CAR, lanes, wheel, accel)
    for i, (state, one_wheel, one_accel) in enumerate(drawn):
        expected = derivative(SINGLE_TRACK, FLOAT, DEFAULT_CAR, state, one_wheel, one_accel)
        assert [v[i] for v in found] == pytest.approx(list(expected), rel=1e-12, abs=1e-12)
