"""Keys move the servo and set its centre and stops; the session's servo becomes a new scaling."""

import pytest

from steerd.daemon.cli.commands.setup.calibrate import servo_scaling, servo_values
from steerd.daemon.setup.steering_calibration import SteeringCalibration
from steerd.daemon.terminal.servo_keys import Servo, press
from steerd.vesc_link.scaling import F1TENTH, Scaling, steer_to_servo_pos


def after(keys, scaling=F1TENTH):
    servo = Servo(scaling.servo_offset, scaling)
    for key in keys:
        servo = press(servo, key)
    return servo


def test_moves_stay_between_0_and_1():
    assert after("aaA").position == pytest.approx(0.5304 - 0.01 - 0.05)
    assert after(["\x1b[C", "\x1b[D", "d"]).position == pytest.approx(0.5354)
    assert after("A" * 30).position == 0.0
    assert after("D" * 30).position == 1.0


def test_centre_and_stops_are_set_where_the_servo_is():
    s = after("dd" + "c" + "AAAA" + "l" + "DDDDDDDD" + "r").scaling
    assert s.servo_offset == pytest.approx(0.5404)
    assert s.servo_min == pytest.approx(0.3404)
    assert s.servo_max == pytest.approx(0.7404)
    mirrored = Scaling(servo_gain=1.0, servo_offset=0.5)
    s = after("DDDlAAAAAAr", mirrored).scaling
    assert (s.servo_min, s.servo_max) == pytest.approx((0.35, 0.65))


def test_stops_that_cannot_be_are_refused_and_other_keys_do_nothing():
    with pytest.raises(ValueError, match="servo limits"):
        after("DDDDDDDDl")
    assert after(["", "x", "\x1b"]) == Servo(0.5304, F1TENTH)


def steering(**change):
    values = {
        "gain": 0.9, "bias": 0.02, "delay": 0.05, "left": 0.25, "right": -0.2,
        "clipped_left": False, "clipped_right": False, "residual": 0.001, "sd_gain": 0.0,
        "sd_bias": 0.0, "warnings": (),
    }  # fmt: skip
    return SteeringCalibration(**{**values, **change})


@pytest.mark.parametrize("angle", [-0.2, 0.0, 0.17])
def test_with_the_new_scaling_the_wheels_go_where_they_are_commanded(angle):
    found, new = steering(), servo_scaling(steering(), F1TENTH)
    position = steer_to_servo_pos(new, angle)
    commanded = (position - F1TENTH.servo_offset) / F1TENTH.servo_gain
    assert found.gain * commanded + found.bias == pytest.approx(angle, abs=1e-12)


def test_limits_move_inwards_to_the_stops_only():
    free = servo_scaling(steering(), F1TENTH)
    assert (free.servo_min, free.servo_max) == (0.15, 0.85)
    new = servo_scaling(steering(gain=1.0, bias=0.0, clipped_left=True, clipped_right=True,
                                 left=0.2, right=-0.18), F1TENTH)  # fmt: skip
    assert new.servo_min == pytest.approx(0.5304 - 1.2135 * 0.2)
    assert new.servo_max == pytest.approx(0.5304 + 1.2135 * 0.18)
    assert servo_values(new)["car", "steer_gain"] == 1.0
