"""What was learnt, on a screen and for programs."""

import json

import pytest

from steerd.daemon.learning.reported import ReportedValue
from steerd.daemon.learning.text import encode_model, format_model, gap_text, with_sd
from steerd.steer_bus import messages as m


def test_a_named_change_says_when_what_and_how_sure(make_report, make_change):
    text = gap_text(make_report("named", make_change())).replace("\u00a0", " ")
    assert text == "since 11:59:20: steer_bias +0.0213 ± 0.0021 rad, 97 %"


def test_what_a_drive_cannot_tell_apart_is_a_set(make_report, make_change):
    text = gap_text(make_report("named", make_change(alternatives=("steer_gain", "mocap_yaw"))))
    assert text.endswith("; this drive cannot distinguish it from steer_gain, mocap_yaw")


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("changed", "since 11:59:20: something changed, too early to say what"),
        ("unexplained", "since 11:59:20: something changed that no effect explains"),
    ],
)
def test_a_change_without_a_name_has_none(make_report, make_change, verdict, words):
    assert gap_text(make_report(verdict, make_change(verdict))) == words


@pytest.mark.parametrize(
    ("verdict", "words"), [("none", "no change of the car"), ("learning", "learning the car")]
)
def test_nothing_is_said_of_a_car_that_did_not_change(make_report, verdict, words):
    assert gap_text(make_report(verdict)) == words


def test_the_screen_fits_80_columns_and_hides_what_is_not_identifiable(make_report, make_change):
    change = make_change(alternatives=("steer_gain", "mocap_yaw", "cornering_stiffness"))
    lines = format_model(make_report("named", change))
    assert max(map(len, lines)) <= 80
    assert "  steer_gain  0.980 ± 0.012" in lines
    assert "not identifiable here: inertia_z" in lines


def test_json_has_the_gap_and_the_model(make_report, make_change):
    report = make_report("named", make_change(alternatives=("mocap_yaw",)))
    values = json.loads(json.dumps(encode_model(report), allow_nan=False))
    gap = values["gap"]
    assert gap["verdict"] == "named"
    assert gap["since_s"] == pytest.approx(m.stamp_ns(report.header) * 1e-9 - 40.0)
    (cause,) = gap["causes"]
    assert cause["effect"] == "steer_bias"
    assert cause["alternatives"] == ["mocap_yaw"]
    assert cause["parameters"]["bias"]["value"] == pytest.approx(0.0213)
    gain = values["model"]["steer_gain"]
    assert gain == {"value": 0.98, "sd": 0.012, "unit": "1", "identifiable": True}
    assert values["model"]["inertia_z"]["identifiable"] is False


def test_json_of_a_change_without_a_name_holds_no_nan(make_report, make_change):
    values = encode_model(make_report("changed", make_change("changed")))
    assert json.dumps(values, allow_nan=False)
    assert values["gap"]["causes"] == []


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (0.02134, 0.0021, "0.0213 ± 0.0021 rad"),
        (12.3, 4.2, "12.3 ± 4.2 rad"),
        (123.4, 42.0, "123 ± 42 rad"),
        (0.5, float("nan"), "0.5 rad"),
    ],
)
def test_numbers_have_the_digits_of_their_error(value, sd, shown):
    text = with_sd(ReportedValue("bias", value, sd, "rad"))
    assert text.replace("\u00a0", " ") == shown
