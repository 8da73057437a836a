"""The sweep's file: lists are crossed, seeds shared, draws of the shape that was asked for."""

import numpy as np
import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.sweep.plan import Quantity, list_cases, load_sweep, parse_distribution


def test_lists_are_crossed_and_every_combination_meets_every_seed(make_plan):
    plan = make_plan({"path": ["line", "figure8"], "car.mass": [3.0, 3.5, 4.0]}, seeds=[4, 7])
    cases = list(list_cases(plan))
    assert plan.count == len(cases) == 12
    assert [case.number for case in cases] == list(range(12))
    assert [case.seed for case in cases] == [4, 7] * 6
    found = {(c.values["path"], c.values["car.mass"], c.seed) for c in cases}
    assert len(found) == 12


def test_a_seed_draws_the_same_in_every_combination(make_plan):
    drawn = {"car.mu": {"low": 0.5, "high": 1.0}}
    plan = make_plan({"speed": [1.0, 2.0], **drawn}, seeds=5)
    cases = list(list_cases(plan))
    slow, fast = cases[:5], cases[5:]
    assert [c.values["car.mu"] for c in slow] == [c.values["car.mu"] for c in fast]
    alone = list(list_cases(make_plan(drawn, seeds=9)))
    assert [c.values["car.mu"] for c in alone[:5]] == [c.values["car.mu"] for c in slow]


def test_a_share_is_one_of_the_car_files_value(make_plan, car):
    drawn = make_plan({"car.mass": {"share": 0.1}}).vary["car.mass"]
    assert (drawn.one, drawn.other) == (car.car.mass, pytest.approx(0.1 * car.car.mass))


def test_the_digest_knows_what_the_drives_depend_on(make_plan):
    given = {"car.mu": {"low": 0.5, "high": 1.0}}
    first = make_plan(given, seeds=5).digest()
    assert first == make_plan(given, seeds=5).digest()
    others = [
        make_plan(given, seeds=6),
        make_plan(given, seeds=5, duration=3.0),
        make_plan(given, seeds=5, path="line"),
        make_plan({"car.mu": {"low": 0.5, "high": 1.1}}, seeds=5),
        make_plan({"car.mu": [0.5, 1.0]}, seeds=5),
        make_plan({}, seeds=5),
    ]
    assert len({first, *(plan.digest() for plan in others)}) == 7


@pytest.mark.parametrize(
    ("vary", "more", "said"),
    [
        ({"car.masss": [3.0]}, {}, "did you mean car.mass"),
        ({"weather": [1.0]}, {}, "a sweep varies"),
        ({"effect.steer_dely": [0.1]}, {}, "steer_delay"),
        ({"effect.grip_patch": [0.1]}, {}, "which of"),
        ({"effect.steer_delay.size": [0.1]}, {}, "has no 'size'"),
        ({"car.mass": [30000.0]}, {}, "car.mass = 30000"),
        ({"car.mass": []}, {}, "the list is empty"),
        ({"car.mass": ["heavy"]}, {}, "must be a number"),
        ({"path": {"low": 0.0, "high": 1.0}}, {}, "give a list"),
        ({"path": [3.0]}, {}, "must be a text"),
        ({}, {"seeds": 0}, "seeds"),
        ({}, {"seeds": [1, 1]}, "seeds"),
        ({}, {"seeds": [-1]}, "seeds"),
        ({}, {"seeds": True}, "seeds"),
        ({}, {"duration": -1.0}, "duration"),
        ({}, {"speed": "fast"}, "speed"),
        ({}, {"sedes": 3}, "did you mean seeds"),
        ({"car.mass": [3.0] * 2000}, {"seeds": 1000}, "2000000 drives"),
    ],
)
def test_what_is_impossible_is_refused_in_a_line(make_plan, vary, more, said):
    with pytest.raises(SteerdError, match=said) as caught:
        make_plan(vary, **more)
    assert "\n" not in caught.value.what


def test_a_file_that_is_no_toml_is_refused(tmp_path):
    (tmp_path / "s.toml").write_text("[vary\n")
    with pytest.raises(SteerdError) as caught:
        load_sweep(tmp_path / "s.toml")
    assert caught.value.code is ExitCode.INVALID
    with pytest.raises(SteerdError) as caught:
        load_sweep(tmp_path / "none.toml")
    assert caught.value.code is ExitCode.UNREADABLE


# Draws: repeatable, apart from each other, within bounds.

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
