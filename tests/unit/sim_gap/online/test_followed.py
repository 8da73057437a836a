"""What is followed of a learnt car: changes that are named beyond doubt, and nothing in doubt."""

from types import SimpleNamespace

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.controller.learnt import learnt_of
from steerd.sim_gap.online import values as online
from steerd.sim_gap.online.learner import State
from steerd.sim_gap.online.values import Value
from steerd.sim_gap.verdict.confidence import Cause
from tests.unit.sim_gap.online.conftest import change


@pytest.fixture
def aim(learner, monkeypatch):
    """What is followed after past changes and one now, of a base that was learnt to be `values`."""

    def find(*past, now=None, values=()):
        monkeypatch.setattr(online, "values_of", lambda known: values)
        return online.find_aim(learner, State(known=SimpleNamespace(), past=past, change=now))

    return find


def test_nothing_is_followed_before_the_car_is_known_or_a_change_has_some_windows(learner, aim):
    assert online.find_aim(learner, State()) == "the car is being learnt"
    early = change("steer_bias", 0.02, windows=online.SETTLED - 1)
    assert aim(now=early) == "a change is being looked into"


FILE = learnt_of(load_car(default_car_path()).car)
SHIFT = {"forward": (0.03, 0.001, "m"), "left": (0.0, 0.001, "m")}
ALONE = {"proven": (Cause("marker_offset", "observe", "sensor", SHIFT, 0.95, (), ""), (0.01, 0.0))}
"""A name that stood alone before others came beside it, and its parameters before the change."""


@pytest.mark.parametrize(("changes", "numbers"), [
    ([change("steer_gain", 0.88)], {"steer_gain": 0.88}),
    ([change("steer_bias", 0.02)], {"steer_bias": 0.02}),
    ([change("steer_delay", 0.04)], {"steer_delay": 0.05}),
    ([change("tyre_friction", 0.6, 0.0)], {"c_sf": 4.718}),  # as stiff below its limit
    ([change("tyre_friction", 0.6, 1.0)], {"c_sf": 0.6 * 4.718, "c_sr": 0.6 * 5.4562}),
    ([change("mocap_yaw", 0.03)], {"body_yaw": 0.03}),
    # What moved by chance stays as it was, and what an effect was before is no part of it.
    ([change("marker_offset", 0.03, 0.0014)], {"body_forward": 0.03, "body_left": 0.0}),
    ([change("marker_offset", -0.0014, 0.0016)], {"body_forward": 0.0, "body_left": 0.0016}),
    ([change("marker_offset", 0.037, 0.001, was=(0.007, 0.001))], {"body_forward": 0.03}),
    ([change("steer_bias", 0.02), change("steer_gain", 0.9)],
     {"steer_bias": 0.02, "steer_gain": 0.9}),
    # A set that is all lateness is followed as its likeliest; how sure the set is counts.
    ([change("steer_delay", 0.04, beside=("steer_lag", "mocap_latency"))],
     {"steer_delay": 0.05}),
    ([change("steer_delay", 0.04, sure=0.5, beside=("steer_lag",), together=0.9)],
     {"steer_delay": 0.05}),
    # A name that stood alone survives others beside it, with its value now or then.
    ([change("marker_offset", 0.032, 0.0, beside=("cornering_stiffness",), **ALONE)],
     {"body_forward": 0.022}),
    ([change("cornering_stiffness", 0.8, beside=("marker_offset", "yaw_inertia"), **ALONE)],
     {"body_forward": 0.02}),
    ([change("steer_bias", 0.02, **ALONE)], {"steer_bias": 0.02, "body_forward": 0.0}),
])  # fmt: skip
def test_a_named_change_is_followed_by_its_numbers_alone(aim, changes, numbers):
    *past, last = changes
    for found in (aim(*changes), aim(*past, now=last)):
        assert found._asdict() == pytest.approx(FILE._asdict() | numbers, rel=1e-6)


@pytest.mark.parametrize(("doubtful", "why"), [
    (change("steer_bias", 0.02, verdict="changed"), "looked into"),
    (change("steer_bias", 0.02, verdict="unexplained"), "unexplained"),
    (change("steer_bias", 0.02, sure=0.5), "not sure"),
    (change("marker_offset", 0.03, 0.0, beside=("cog_offset",)), "or cog_offset"),
    (change("steer_delay", 0.04, sure=0.5, beside=("steer_lag",), together=0.7), "not sure"),
    (change("steer_delay", 0.04, beside=("steer_lag", "yaw_inertia")), "or yaw_inertia"),
    (change("yaw_inertia", 0.8, beside=("cog_offset",), **ALONE), "or cog_offset"),
    (change("marker_offset", 0.03, 0.0, verdict="unexplained", **ALONE), "unexplained"),
    (change("marker_offset", 0.03, 0.0, sure=0.5, **ALONE), "not sure"),
])  # fmt: skip
def test_doubt_is_said_and_not_followed(aim, doubtful, why):
    assert why in aim(doubtful)
    assert why in aim(now=doubtful)
    assert why in aim(doubtful, change("steer_gain", 0.9)), "also an earlier one"


def test_bias_and_speed_are_followed_by_themselves_where_they_are_sure(aim):
    bias = Value("steer_bias", 0.01, 0.001, "rad", True)
    others = Value("speed_gain", 0.99, 0.02, "1", True), Value("c_sf", 3.0, 0.1, "1/rad", True)
    assert aim(values=(bias, *others)) == FILE._replace(steer_bias=0.01)
    assert aim(values=(bias._replace(identifiable=False), *others)) == FILE
    known_better = aim(change("steer_bias", 0.02), values=(bias,))
    assert known_better.steer_bias == pytest.approx(0.02), "a named change knows better"
