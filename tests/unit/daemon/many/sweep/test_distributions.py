"""Draws: repeatable, apart from each other, within bounds, of the shape that was asked for."""

import numpy as np
import pytest

from steerd.daemon.many.sweep.plan import Quantity, parse_distribution

N = 4000


def draws(given, low=-1e9, high=1e9, usual=None, name="car.mass"):
    found = parse_distribution(Quantity(name, low, high, "kg", "", usual), given)
    return np.array([found.draw(name, seed) for seed in range(N)])


@pytest.mark.parametrize(
    ("given", "usual", "quantiles"),
    [
        ({"low": 1.0, "high": 3.0}, None, (1.1, 2.0, 2.9)),
        ({"low": 1.0, "high": 100.0, "log": True}, None, (1.26, 10.0, 79.4)),
        ({"low": 1.0, "high": 3.0, "log": False}, None, (1.1, 2.0, 2.9)),
        ({"mean": 5.0, "sd": 2.0}, None, (1.71, 5.0, 8.29)),
        ({"median": 4.0, "factor": 2.0}, None, (1.28, 4.0, 12.5)),
        ({"share": 0.1}, 3.0, (2.51, 3.0, 3.49)),
    ],
)
def test_draws_have_the_shape(given, usual, quantiles):
    found = np.quantile(draws(given, usual=usual), (0.05, 0.5, 0.95))
    np.testing.assert_allclose(found, quantiles, rtol=0.06)


def test_a_draw_depends_on_seed_and_name_alone():
    one = draws({"mean": 0.0, "sd": 1.0})
    np.testing.assert_array_equal(one, draws({"mean": 0.0, "sd": 1.0}))
    other = draws({"mean": 0.0, "sd": 1.0}, name="car.mu")
    assert abs(np.corrcoef(one, other)[0, 1]) < 4.0 / np.sqrt(N)
    assert len(set(one)) == N


def test_nothing_is_drawn_outside_the_bounds():
    values = draws({"mean": 1.0, "sd": 1.0}, low=0.5, high=2.0)
    assert values.min() >= 0.5
    assert values.max() <= 2.0
    assert np.std(values) > 0.3, "cut, not clipped"
    assert (values == 0.5).sum() == 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "low, high"),
        ({"low": 1.0}, "low, high"),
        ({"lo": 1.0, "high": 2.0}, "did you mean low"),
        ({"low": 2.0, "high": 1.0}, "not below"),
        ({"low": 0.0, "high": 1.0, "log": True}, "positive"),
        ({"low": -5.0, "high": 5.0}, "-1 to 10"),
        ({"mean": 3.0, "sd": 0.0}, "more than 0"),
        ({"mean": "x", "sd": 1.0}, "must be a number"),
        ({"mean": True, "sd": 1.0}, "must be a number"),
        ({"mean": float("nan"), "sd": 1.0}, "must be a number"),
        ({"mean": 30.0, "sd": 1.0}, "-1 to 10"),
        ({"share": 0.1}, "give mean and sd"),
    ],
)
def test_what_is_no_distribution_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        parse_distribution(Quantity("car.mass", -1.0, 10.0, "kg", ""), given)


def test_a_distribution_that_never_meets_its_bounds_ends():
    found = parse_distribution(Quantity("x", -1e-6, 1e-6, "1", ""), {"mean": 0.0, "sd": 1e6})
    with pytest.raises(ValueError, match="nothing between"):
        found.draw("x", 0)
