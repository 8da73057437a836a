"""What filter and recording believe was sent is what a VESC makes of the bytes."""

from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.vesc_link.commands import SetErpm, SetServoPos
from steerd.vesc_link.packets import decode_command, encode_command
from steerd.vesc_link.scaling import (
    F1TENTH,
    as_sent,
    erpm_to_speed,
    servo_pos_to_steer,
    speed_to_erpm,
    steer_to_servo_pos,
)

ANGLES = st.floats(-0.4, 0.4)
SPEEDS = st.floats(-6.0, 6.0)


@given(ANGLES, SPEEDS)
@settings(derandomize=True, deadline=None)
def test_as_sent_is_what_the_device_decodes(steer: float, speed: float) -> None:
    servo = decode_command(encode_command(SetServoPos(steer_to_servo_pos(F1TENTH, steer))))
    erpm = decode_command(encode_command(SetErpm(speed_to_erpm(F1TENTH, speed))))
    assert isinstance(servo, SetServoPos)
    assert isinstance(erpm, SetErpm)
    got_steer, got_speed = as_sent(F1TENTH, steer, speed)
    assert abs(got_steer - servo_pos_to_steer(F1TENTH, servo.servo_pos)) < 1e-6
    assert abs(got_speed - erpm_to_speed(F1TENTH, erpm.erpm)) < 1e-9


@given(ANGLES, SPEEDS)
@settings(derandomize=True, deadline=None)
def test_sending_what_was_sent_changes_nothing(steer: float, speed: float) -> None:
    once = as_sent(F1TENTH, steer, speed)
    twice = as_sent(F1TENTH, *once)
    assert max(abs(a - b) for a, b in zip(once, twice, strict=True)) < 1e-12
