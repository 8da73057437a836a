import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.vesc_link.commands import SetErpm, SetServoPos
from steerd.vesc_link.packets import decode_command, encode_command
from steerd.vesc_link.scaling import (
    F1TENTH,
    Scaling,
    as_sent,
    erpm_to_speed,
    servo_pos_to_steer,
    speed_to_erpm,
    steer_limits,
    steer_to_servo_pos,
)


def test_f1tenth_numbers_of_the_spec_page():
    assert speed_to_erpm(F1TENTH, 1.0) == 4614.0
    assert erpm_to_speed(F1TENTH, 23250.0) == pytest.approx(5.04, abs=0.002)
    assert steer_to_servo_pos(F1TENTH, 0.0) == 0.5304
    right, left = steer_limits(F1TENTH)
    assert math.degrees(left) == pytest.approx(17.96, abs=0.01)
    assert math.degrees(right) == pytest.approx(-15.09, abs=0.01)


@pytest.mark.parametrize(("steer", "speed"), [(-0.26, -5.0), (-0.1, -0.3), (0.0, 0.0), (0.31, 5.0)])
def test_angles_and_speeds_with_an_offset_come_back(steer, speed):
    scaling = Scaling(erpm_offset=35.0)
    assert servo_pos_to_steer(scaling, steer_to_servo_pos(scaling, steer)) == pytest.approx(steer)
    assert erpm_to_speed(scaling, speed_to_erpm(scaling, speed)) == pytest.approx(speed)


@pytest.mark.parametrize(
    ("convert", "least", "most"),
    [(steer_to_servo_pos, 0.85, 0.15), (speed_to_erpm, -23250.0, 23250.0)],
)
def test_numbers_are_clamped_both_ways_and_what_is_none_never(convert, least, most):
    assert (convert(F1TENTH, -1e6), convert(F1TENTH, 1e6)) == (least, most)
    for value in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match="no command"):
            convert(F1TENTH, value)


def test_positive_servo_gain_keeps_limits_in_order():
    right, left = steer_limits(Scaling(servo_gain=1.2135))
    assert right < 0 < left
    assert math.degrees(left) == pytest.approx(15.09, abs=0.01)


@pytest.mark.parametrize(
    "wrong",
    [
        {"erpm_gain": 0.0},
        {"servo_gain": 0.0},
        {"erpm_gain": math.nan},
        {"servo_min": 0.9},
        {"servo_min": -0.1},
        {"servo_max": 1.1},
        {"erpm_max": 0.0},
        {"erpm_max": math.inf},
    ],
)
def test_unusable_calibration_is_refused(wrong):
    with pytest.raises(ValueError, match=r"must|finite"):
        Scaling(**wrong)


# What filter and recording believe was sent is what a VESC makes of the bytes.


@given(st.floats(-0.4, 0.4), st.floats(-6.0, 6.0))
@settings(derandomize=True, deadline=None)
def test_as_sent_is_what_the_device_decodes_and_sent_again_the_same(steer, speed):
    servo = decode_command(encode_command(SetServoPos(steer_to_servo_pos(F1TENTH, steer))))
    erpm = decode_command(encode_command(SetErpm(speed_to_erpm(F1TENTH, speed))))
    assert isinstance(servo, SetServoPos)
    assert isinstance(erpm, SetErpm)
    once = as_sent(F1TENTH, steer, speed)
    assert abs(once[0] - servo_pos_to_steer(F1TENTH, servo.servo_pos)) < 1e-6
    assert abs(once[1] - erpm_to_speed(F1TENTH, erpm.erpm)) < 1e-9
    assert as_sent(F1TENTH, *once) == pytest.approx(once, abs=1e-12)
