"""What is told of a change is by how much the car moved, whatever it was learnt to have before."""

import pytest

from steerd.car_model.effects import find_effect
from steerd.sim_gap.online.amount import amounts_of
from steerd.sim_gap.online.learner import Change
from steerd.sim_gap.online.naming import Finding
from steerd.sim_gap.verdict.evidence import Cause


def change(effect, after, was):
    parameters = {
        p.name: (value, 0.5, p.unit)
        for p, value in zip(find_effect(effect).parameters, after, strict=True)
    }
    finding = Finding("named", Cause(effect, "", "", parameters, 0.95, (), ""))
    return Change(0.0, 1.0, None, (), finding, was)


def test_an_offset_moved_by_a_difference():
    moved = amounts_of(change("marker_offset", (0.018, 0.001), (-0.0115, 0.0004)))
    assert [value for value, _, _ in moved.values()] == pytest.approx([0.0295, 0.0006])
    assert moved["forward"][1:] == (0.5, "m")


def test_a_ratio_moved_by_a_quotient():
    value, sd, _ = amounts_of(change("speed_scale", (0.76,), (0.8,)))["scale"]
    assert value == pytest.approx(0.95)
    assert sd == pytest.approx(0.625)


def test_of_which_form_an_effect_is_has_no_amount():
    moved = amounts_of(change("lateral_load_transfer", (0.5, 0.7), (0.2, 0.62)))
    assert moved["k"][0] == pytest.approx(0.3)
    assert moved["moved"][0] == 0.7


def test_what_was_not_there_before_moved_by_all_of_it():
    assert amounts_of(change("steer_bias", (0.02,), (0.0,)))["bias"][0] == 0.02


def test_a_change_without_a_name_has_no_amount():
    assert amounts_of(Change(0.0, 1.0, None, ())) == {}
