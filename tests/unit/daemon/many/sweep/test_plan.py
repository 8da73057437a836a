"""The sweep's file: lists are crossed, seeds shared, everything impossible refused."""

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.sweep.plan import list_cases, load_sweep


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
