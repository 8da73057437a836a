"""Effects by name: what a command line may say and what a wrong one reports."""

import pytest

from steerd.car_model.effects import ALIASES, EFFECTS, find_effect, parse_effects


def test_values_in_order_and_by_name():
    assert parse_effects("steer_delay=0.03") == [(EFFECTS["steer_delay"], (0.03,))]
    assert parse_effects("grip_patch=1,-2, 0.5,0.3")[0][1] == (1.0, -2.0, 0.5, 0.3)
    assert parse_effects("grip_patch:drop=0.3,x=2")[0][1] == (2.0, 0.0, 0.5, 0.3)
    assert parse_effects("floor_slope=0.01")[0][1] == (0.01, 0.0, 0.0)


def test_several_effects():
    found = parse_effects("floor_slope=0.01,0.02,backlash:play=0.02,mu=0.6")
    assert [(e.name, v) for e, v in found] == [
        ("floor_slope", (0.01, 0.02, 0.0)),
        ("steer_backlash", (0.02,)),
        ("tyre_friction", (0.6,)),
    ]


def test_a_name_that_is_a_parameter_too_starts_a_new_effect_after_plain_values():
    found = parse_effects("steer_gain=0.9,mass=0.5")
    assert [e.name for e, _ in found] == ["steer_gain", "mass"]


def test_aliases_lead_to_effects_and_hide_none():
    assert not set(ALIASES) & set(EFFECTS)
    assert sum(len(e.aliases) for e in EFFECTS.values()) == len(ALIASES)
    for alias, name in ALIASES.items():
        assert find_effect(alias) is EFFECTS[name]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("steer_dely=0.03", "did you mean 'steer_delay'"),
        ("zzzz=1", "steerd effects"),
        ("steer_delay", "NAME=VALUE"),
        ("", "NAME=VALUE"),
        ("steer_delay=", "must be a number"),
        ("steer_delay=soon", "delay must be a number, not 'soon'"),
        ("steer_delay=nan", "outside 0 to 0.3"),
        ("steer_delay=inf", "outside"),
        ("steer_delay=3", "delay is 3 s, outside 0 to 0.3"),
        ("steer_delay=0.1,0.2", "takes delay, not 2 values"),
        ("steer_delay:lag=0.1", "takes delay, not 'lag'"),
        ("grip_patch:x=1,2", "NAME=VALUE"),
    ],
)
def test_a_wrong_line_is_named_with_its_problem(text, says):
    with pytest.raises(ValueError, match=says.replace("(", r"\(")):
        parse_effects(text)
