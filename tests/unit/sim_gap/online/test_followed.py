"""What is followed of a learnt car: changes that are named beyond doubt, and nothing in doubt."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.effects import find_effect
from steerd.controller.learnt import Learnt, learnt_of
from steerd.sim_gap.online import values as online
from steerd.sim_gap.online.learner import Change, State
from steerd.sim_gap.online.naming import Finding
from steerd.sim_gap.online.values import Value
from steerd.sim_gap.verdict.evidence import Cause

KNOWN = SimpleNamespace()
SETTLED = online.SETTLED


@pytest.fixture
def values(monkeypatch):
    """What the base was learnt as."""
    learnt: list[Value] = []
    monkeypatch.setattr(online, "values_of", lambda known: tuple(learnt))
    return learnt


def change(
    effect, *after, verdict="named", sure=0.95, alternatives=(), windows=SETTLED, together=0.0
):
    found = find_effect(effect)
    parameters = {
        p.name: (value, 0.0005, p.unit) for p, value in zip(found.parameters, after, strict=True)
    }
    cause = Cause(effect, "", found.family, parameters, sure, alternatives, "")
    finding = Finding(verdict, cause if verdict == "named" else None, max(sure, together))
    return Change(0.0, 1.0, None, ((0.0, None),) * windows, finding, found.nulls)


def aim(learner, *past, now=None):
    return online.find_aim(learner, State(known=KNOWN, past=past, change=now))


def test_before_the_car_is_known_there_is_nothing_to_follow(learner):
    assert online.find_aim(learner, State()) == "the car is being learnt"


def test_a_car_that_is_as_in_the_file_is_followed_as_that(learner, values):
    car = load_car(default_car_path()).car
    assert aim(learner) == learnt_of(car)


@pytest.mark.parametrize(
    ("effect", "after", "name", "value"),
    [
        ("steer_gain", (0.88,), "steer_gain", 0.88),
        ("steer_bias", (0.02,), "steer_bias", 0.02),
        ("steer_delay", (0.04,), "steer_delay", 0.05),
        ("tyre_friction", (0.6,), "c_sf", 4.718),  # as stiff below its limit
        ("mocap_yaw", (0.03,), "body_yaw", 0.03),
        ("marker_offset", (0.03, 0.0), "body_forward", 0.03),
    ],
)
def test_a_named_change_is_followed_by_its_number(learner, values, effect, after, name, value):
    for found in (aim(learner, change(effect, *after)), aim(learner, now=change(effect, *after))):
        assert isinstance(found, Learnt)
        assert getattr(found, name) == pytest.approx(value, rel=1e-6)


def test_a_parameter_that_moved_by_chance_stays_as_it_was(learner, values):
    pushed = aim(learner, change("marker_offset", 0.03, 0.0014))
    assert (pushed.body_forward, pushed.body_left) == (0.03, 0.0)
    aside = aim(learner, change("marker_offset", -0.0014, 0.0016))
    assert (aside.body_forward, aside.body_left) == (0.0, 0.0016)


def test_what_an_effect_was_before_is_no_part_of_its_change(learner, values):
    shifted = replace(change("marker_offset", 0.037, 0.001), was=(0.007, 0.001))
    assert aim(learner, shifted).body_forward == pytest.approx(0.03)


def test_two_changes_add_up(learner, values):
    found = aim(learner, change("steer_bias", 0.02), change("steer_gain", 0.9))
    assert (found.steer_bias, found.steer_gain) == pytest.approx((0.02, 0.9))


@pytest.mark.parametrize(
    ("doubtful", "why"),
    [
        (change("steer_bias", 0.02, verdict="changed"), "looked into"),
        (change("steer_bias", 0.02, verdict="unexplained"), "unexplained"),
        (change("steer_bias", 0.02, sure=0.5), "not sure"),
        (change("marker_offset", 0.03, 0.0, alternatives=("cog_offset",)), "or cog_offset"),
    ],
)
def test_doubt_is_said_and_not_followed(learner, values, doubtful, why):
    assert why in aim(learner, doubtful)
    assert why in aim(learner, now=doubtful)
    assert why in aim(learner, doubtful, change("steer_gain", 0.9)), "also an earlier one"


def test_a_name_counts_only_after_some_windows(learner, values):
    early = change("steer_bias", 0.02, windows=SETTLED - 1)
    assert aim(learner, now=early) == "a change is being looked into"


def test_bias_and_speed_are_followed_by_themselves_where_they_are_sure(learner, values):
    values += [
        Value("steer_bias", 0.01, 0.001, "rad", True),
        Value("speed_gain", 0.99, 0.02, "1", True),
        Value("c_sf", 3.0, 0.1, "1/rad", True),
    ]
    found = aim(learner)
    assert (found.steer_bias, found.speed_gain, found.c_sf) == (0.01, 1.0, pytest.approx(4.718))
    values[0] = values[0]._replace(identifiable=False)
    assert aim(learner).steer_bias == 0.0


def test_a_named_change_knows_better_than_the_base(learner, values):
    values.append(Value("steer_bias", 0.004, 0.0005, "rad", True))
    assert aim(learner, change("steer_bias", 0.02)).steer_bias == pytest.approx(0.02)


def test_a_set_that_is_all_lateness_is_followed_as_its_likeliest(learner, values):
    late = change("steer_delay", 0.04, alternatives=("steer_lag", "mocap_latency"))
    file = learnt_of(load_car(default_car_path()).car)
    assert aim(learner, now=late) == file._replace(steer_delay=file.steer_delay + 0.04)


def test_how_sure_a_set_of_lateness_is_counts_and_not_its_likeliest_name(learner, values):
    late = change("steer_delay", 0.04, sure=0.5, alternatives=("steer_lag",), together=0.9)
    assert isinstance(aim(learner, now=late), Learnt)
    doubtful = change("steer_delay", 0.04, sure=0.5, alternatives=("steer_lag",), together=0.7)
    assert aim(learner, now=doubtful) == "the name of a change is not sure"


def test_a_set_that_is_lateness_and_something_else_is_in_doubt(learner, values):
    late = change("steer_delay", 0.04, alternatives=("steer_lag", "yaw_inertia"))
    assert aim(learner, now=late) == "a change is steer_delay or steer_lag or yaw_inertia"


SHIFT = {"forward": (0.03, 0.001, "m"), "left": (0.0, 0.001, "m")}
ALONE = Cause("marker_offset", "observe", "sensor", SHIFT, 0.95, (), "")


def proven(later, was=(0.01, 0.0)):
    return replace(later, proven=(ALONE, was))


def test_a_name_that_stood_alone_survives_others_beside_it(learner, values):
    first = change("marker_offset", 0.032, 0.0, alternatives=("cornering_stiffness",))
    assert "or cornering_stiffness" in aim(learner, now=first)
    assert aim(learner, now=proven(first)).body_forward == pytest.approx(0.022), "its value now"
    second = change("cornering_stiffness", 0.8, alternatives=("marker_offset", "yaw_inertia"))
    for found in (aim(learner, now=proven(second)), aim(learner, proven(second))):
        assert found.body_forward == pytest.approx(0.02), "its value then"


@pytest.mark.parametrize(
    ("later", "why"),
    [
        (change("yaw_inertia", 0.8, alternatives=("cog_offset",)), "or cog_offset"),
        (change("marker_offset", 0.03, 0.0, verdict="unexplained"), "unexplained"),
        (change("marker_offset", 0.03, 0.0, sure=0.5), "not sure"),
    ],
)
def test_what_no_longer_has_that_name_is_in_doubt(learner, values, later, why):
    assert why in aim(learner, now=proven(later))


def test_another_name_that_stands_alone_is_followed_instead(learner, values):
    later = proven(change("steer_bias", 0.02))
    found = aim(learner, now=later)
    assert (found.steer_bias, found.body_forward) == (pytest.approx(0.02), 0.0)
