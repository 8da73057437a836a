"""Where the wheels are, by the orders that left."""

from math import exp

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.state import Command
from steerd.controller.servo import KEPT_NS, Servo, order_servo, step_servo

MS = 1_000_000
CAR = DEFAULT_CAR._replace(steer_gain=0.9, steer_bias=0.01, steer_lag=0.05)


def wheel_after(ms, delay_s=0.03, order=0.2):
    servo = order_servo(Servo(t_ns=0, wheel=0.01), 0, Command(order, 1.0))
    for t in range(1, ms + 1):
        servo = step_servo(servo, CAR, delay_s, t * MS)
    return servo.wheel


def test_the_wheel_stays_for_the_dead_time_and_follows_with_the_lag():
    assert wheel_after(29) == pytest.approx(0.01)
    assert wheel_after(29 + 50) == pytest.approx(0.01 + 0.18 * (1.0 - exp(-1.0)), rel=1e-2)
    assert wheel_after(500) == pytest.approx(0.9 * 0.2 + 0.01, rel=1e-3)


def test_it_stops_at_the_end_stop():
    assert wheel_after(800, order=1.0) == pytest.approx(CAR.steer_max, rel=1e-3)


def test_orders_are_kept_as_long_as_a_dead_time_can_be_and_no_longer():
    servo = Servo()
    for k in range(300):
        servo = order_servo(servo, k * 10 * MS, Command(0.001 * k, 1.0))
    times = [t for t, _ in servo.orders]
    assert times[0] < 2990 * MS - KEPT_NS <= times[1]
    assert order_servo(servo, 3_000 * MS, None) == servo, "a brake moves no wheel"
