"""Where the front wheels are, by the orders that left: a dead time and a first-order lag.

The state filter holds the car of the car file. A controller that follows another dead time, gain or
bias is given where the wheels of that car are.
"""

from math import exp
from typing import NamedTuple

from steerd.car_model.actuators import LAG_FLOOR
from steerd.car_model.params import Car
from steerd.car_model.state import Command

KEPT_NS = 600_000_000
"""How long orders are kept: longer than any dead time."""
STEP_MAX_S = 0.1
"""Longest time that one step is granted [s]."""
_NS, _SECONDS = 1_000_000_000, 1e-9


class Servo(NamedTuple):
    """Orders lately, and the wheel angle [rad] at `t_ns`."""

    orders: tuple[tuple[int, float], ...] = ()
    wheel: float = 0.0
    t_ns: int = 0


def order_servo(servo: Servo, t_ns: int, order: Command[float] | None) -> Servo:
    """With what left now; nothing leaves the last order as it is."""
    if order is None or (servo.orders and servo.orders[-1][1] == order.steer):
        return servo
    oldest = t_ns - KEPT_NS
    first = sum(1 for sent_ns, _ in servo.orders if sent_ns < oldest)
    kept = servo.orders[max(first - 1, 0) :]
    return servo._replace(orders=(*kept, (t_ns, order.steer)))


def step_servo(servo: Servo, car: Car[float], delay_s: float, t_ns: int) -> Servo:
    """The wheel angle at `t_ns`, for a car's gain, bias and lag and this dead time [s]."""
    due_ns = t_ns - round(delay_s * _NS)
    held = next((steer for sent_ns, steer in reversed(servo.orders) if sent_ns <= due_ns), 0.0)
    aim = min(max(car.steer_gain * held + car.steer_bias, car.steer_min), car.steer_max)
    h = min(max((t_ns - servo.t_ns) * _SECONDS, 0.0), STEP_MAX_S)
    share = 1.0 - exp(-h / max(car.steer_lag, LAG_FLOOR))
    return servo._replace(wheel=servo.wheel + share * (aim - servo.wheel), t_ns=t_ns)
