"""The instruments: what each reads of the state, how noisily, and its innovation gate."""

from enum import IntEnum
from functools import lru_cache
from math import erfc, exp, gamma, sqrt
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.car_model.state import State
from steerd.estimator.config import FilterConfig

_YAW = State._fields.index("yaw")
_HALVINGS = 80
ABSURD = 1e6  # no reading of any instrument, in any SI unit, is this large; `filter.h` has it too


class Kind(IntEnum):
    """Which instrument spoke. Measurements of one instant are fused in this order.

    Poses come last because they arrive last: the others need not be fused again.
    """

    WHEEL_SPEED = 0
    GYRO = 1
    POSE = 2


class Measurement(NamedTuple):
    """One reading. Sorting tuples sorts by time of validity, then instrument, then values."""

    t_ns: int  # time of validity, CLOCK_MONOTONIC [ns]
    kind: Kind
    values: tuple[float, ...]


class Sensor(NamedTuple):
    """How an instrument sees the state: each reading is one state times a common gain."""

    states: tuple[int, ...]  # which state each reading is of
    gain: float
    variances: tuple[float, ...]
    gate: float  # largest normalised innovation squared that is believed (chi-square)

    @property
    def yaw_row(self) -> int | None:
        """Which reading is an angle that wraps."""
        return self.states.index(_YAW) if _YAW in self.states else None


def make_pose(t_valid_ns: int, x: float, y: float, yaw: float) -> Measurement:
    """A mocap pose of the CoG: [m], [m], [rad], valid at mid-exposure."""
    return Measurement(t_valid_ns, Kind.POSE, (x, y, yaw))


def make_wheel_speed(t_ns: int, speed: float) -> Measurement:
    """A wheel speed with the nominal gain [m/s], valid half-way between request and reply."""
    return Measurement(t_ns, Kind.WHEEL_SPEED, (speed,))


def make_gyro(t_ns: int, yaw_rate: float) -> Measurement:
    """A yaw rate [rad/s], positive to the left."""
    return Measurement(t_ns, Kind.GYRO, (yaw_rate,))


def make_sensors(car: Car[float], config: FilterConfig) -> dict[Kind, Sensor]:
    """The instruments of a car. The wheel reads `speed / speed_gain`, as `car_model.observe`."""

    def sensor(gain: float, **sds: float) -> Sensor:
        states = tuple(State._fields.index(name) for name in sds)
        gate = chi_square_gate(len(sds), config.gate_probability)
        return Sensor(states, gain, tuple(sd * sd for sd in sds.values()), gate)

    position, yaw = config.pose_position_sd, config.pose_yaw_sd
    return {
        Kind.POSE: sensor(1.0, x=position, y=position, yaw=yaw),
        Kind.WHEEL_SPEED: sensor(1.0 / car.speed_gain, speed=config.wheel_speed_sd),
        Kind.GYRO: sensor(1.0, yaw_rate=config.gyro_sd),
    }


def chi_square_above(degrees: int, x: float) -> float:
    """Probability that a chi-square variable of so many degrees of freedom is larger than `x`."""
    found, k = (erfc(sqrt(0.5 * x)), 1) if degrees % 2 else (exp(-0.5 * x), 2)
    while k < degrees:
        found += (0.5 * x) ** (0.5 * k) * exp(-0.5 * x) / gamma(0.5 * k + 1.0)
        k += 2
    return found


@lru_cache(maxsize=64)
def chi_square_gate(degrees: int, probability: float) -> float:
    """What a chi-square variable stays below with a probability, by bisection."""
    low, high = 0.0, 1.0
    while chi_square_above(degrees, high) > 1.0 - probability:
        high *= 2.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if chi_square_above(degrees, middle) > 1.0 - probability:
            low = middle
        else:
            high = middle
    return high
