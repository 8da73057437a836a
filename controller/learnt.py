"""What a controller may follow while it drives: numbers of the car, how far and how fast.

The bounds lie about the car file's own numbers and never reach beyond what any car can have. A
design for such numbers is checked before it is taken (`steerd.controller.acceptance`).

The state filter holds the car of the car file. A controller that follows another dead time, gain or
bias is given where the wheels of that car are, by the orders that left: `Servo`.
"""

# Why: docs/decisions/filter-and-controller.md#d85

from math import exp
from typing import NamedTuple

from steerd.car_model.actuators import LAG_FLOOR
from steerd.car_model.params import PARAMETERS, Car
from steerd.car_model.state import Command
from steerd.controller.gain_table import GainTable
from steerd.controller.lane_controller import LaneController
from steerd.controller.loop_model import Timing


class Learnt(NamedTuple):
    """The numbers that are followed: of the car, then of the mocap body on it."""

    steer_gain: float  # [1]
    steer_bias: float  # [rad]
    steer_delay: float  # [s]
    steer_lag: float  # [s]
    speed_gain: float  # [1]
    c_sf: float  # [1/rad]
    c_sr: float  # [1/rad]
    body_yaw: float = 0.0  # the body's heading in the car [rad]
    body_forward: float = 0.0  # the body's origin ahead of the CoG [m]
    body_left: float = 0.0  # and to the left of it [m]


OF_CAR = Learnt._fields[:7]  # those that are parameters of the car
FARTHEST = Learnt(0.25, 0.06, 0.1, 0.08, 0.1, 0.6, 0.6, 0.08, 0.08, 0.05)
"""How far from the car file's; gains and stiffnesses as a share of it."""
STEP = Learnt(0.03, 0.006, 0.008, 0.01, 0.02, 0.08, 0.08, 0.008, 0.008, 0.008)
"""How far at once, from what is in force; shares likewise."""
_SHARES = ("steer_gain", "speed_gain", "c_sf", "c_sr")
_BOUNDS = {p.name: (p.low, p.high) for p in PARAMETERS}


class Design(NamedTuple):
    """A proposal: the car as learnt, and the gains designed for it."""

    car: Learnt
    table: GainTable


class LearntBounds(NamedTuple):
    """Lowest and highest numbers."""

    low: Learnt
    high: Learnt


def learnt_of(car: Car[float]) -> Learnt:
    """A car's own numbers, the mocap body on its CoG."""
    return Learnt(*(getattr(car, name) for name in OF_CAR))


def make_bounds(car: Car[float]) -> LearntBounds:
    """Bounds about the car that the controller was designed for."""
    at = learnt_of(car)
    low, high = [], []
    for name, value, far in zip(Learnt._fields, at, _scaled(at, FARTHEST), strict=True):
        least, most = _BOUNDS.get(name, (-far, far))
        low.append(max(value - far, least))
        high.append(min(value + far, most))
    return LearntBounds(Learnt(*low), Learnt(*high))


def steps(car: Car[float]) -> Learnt:
    """How far each number may move at once, in its own unit."""
    return _scaled(learnt_of(car), STEP)


def _scaled(at: Learnt, amounts: Learnt) -> Learnt:
    return Learnt(*(
        amount * abs(value) if name in _SHARES else amount
        for name, value, amount in zip(Learnt._fields, at, amounts, strict=True)
    ))  # fmt: skip


def approach_learnt(now: Learnt, aim: Learnt, bounds: LearntBounds, most: Learnt) -> Learnt:
    """One step of at most `most` from `now` towards `aim`, within the bounds."""
    return Learnt(*(
        min(max(min(max(to, at - far), at + far), low), high)
        for at, to, low, high, far in zip(now, aim, *bounds, most, strict=True)
    ))  # fmt: skip


def learnt_car(file: LaneController, learnt: Learnt) -> Car[float]:
    """The file's car with the learnt numbers; its end stops stay."""
    return file.car._replace(**{name: getattr(learnt, name) for name in OF_CAR})


def learnt_timing(file: LaneController, learnt: Learnt) -> Timing:
    """The loop's timing with the learnt dead time and lag."""
    timing = file.report.timing
    delay = max(timing.delay_s + learnt.steer_delay - file.car.steer_delay, 0.0)
    return timing._replace(delay_s=delay, lag_s=learnt.steer_lag)


def follow_learnt(file: LaneController, design: Design) -> LaneController:
    """The controller of an accepted design: path, speeds and end stops are the file's."""
    timing = learnt_timing(file, design.car)
    return file._replace(
        car=learnt_car(file, design.car),
        table=design.table,
        keeper=file.keeper._replace(preview_s=timing.delay_s + timing.lag_s),
        report=file.report._replace(timing=timing),
    )


KEPT_NS = 600_000_000  # how long orders are kept: longer than any dead time
STEP_MAX_S = 0.1  # longest time that one step is granted [s]
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
