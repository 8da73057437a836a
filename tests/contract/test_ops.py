"""One set of equations over every number type: floats and arrays agree."""

import numpy as np
import pytest

from steerd.car_model.chassis import derivative
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import State

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
"""The operations of one or two numbers; the tape's: tests/property/test_car_model.py."""


@pytest.mark.parametrize("function", CHOICES.values(), ids=CHOICES)
def test_an_array_gives_what_each_of_its_numbers_gives(function):
    a, b = map(np.ravel, np.meshgrid(VALUES[1:], VALUES))
    alone = [function(FLOAT, float(x), float(y)) for x, y in zip(a, b, strict=True)]
    assert function(NUMPY, a, b) == pytest.approx(alone, rel=1e-14, abs=1e-15)


def test_choices_of_floats():
    assert (FLOAT.minimum(1.0, 2.0), FLOAT.maximum(1.0, 2.0)) == (1.0, 2.0)
    assert [FLOAT.clip(a, -0.5, 0.5) for a in VALUES] == [-0.5, -0.25, 0.0, 0.25, 0.5]
    assert [FLOAT.where_positive(a, 1.0, 2.0) for a in VALUES] == [2.0, 2.0, 2.0, 1.0, 1.0]


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


def test_lanes_of_an_array_are_cars_of_their_own():
    drawn = points(16)
    lanes = State(*(np.array(v) for v in zip(*(s for s, _, _ in drawn), strict=True)))
    wheel, accel = (np.array([d[i] for d in drawn]) for i in (1, 2))
    found = derivative(SINGLE_TRACK, NUMPY, DEFAULT_CAR, lanes, wheel, accel)
    for i, (state, one_wheel, one_accel) in enumerate(drawn):
        expected = derivative(SINGLE_TRACK, FLOAT, DEFAULT_CAR, state, one_wheel, one_accel)
        assert [v[i] for v in found] == pytest.approx(list(expected), rel=1e-12, abs=1e-12)
