"""The instruments: what each reads of the state, how noisily, and its innovation gate."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from steerd.car_model.params import Car
from steerd.car_model.state import State
from steerd.estimator.belief import Array
from steerd.estimator.config import FilterConfig
from steerd.estimator.gates import chi_square_gate

_FIELDS = State._fields


class Kind(IntEnum):
    """Which instrument spoke. Measurements of one instant are fused in this order.

    Poses come last because they arrive last: the others need not be fused again.
    """

    WHEEL_SPEED = 0
    GYRO = 1
    POSE = 2


class Measurement(NamedTuple):
    """One reading. Sorting tuples sorts by time of validity, then instrument, then values."""

    t_ns: int
    """Time of validity, CLOCK_MONOTONIC [ns]."""
    kind: Kind
    values: tuple[float, ...]


class Sensor(NamedTuple):
    """How an instrument sees the state."""

    matrix: Array
    """(m, 7) readings by states; every instrument here is linear."""
    noise: Array
    """(m, m) covariance."""
    gate: float
    """Largest normalised innovation squared that is believed (chi-square of m)."""
    yaw_row: int | None
    """Which reading is an angle that wraps."""


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
    position, yaw = config.pose_position_sd, config.pose_yaw_sd
    return {
        Kind.POSE: _sensor(config, ("x", "y", "yaw"), (position, position, yaw)),
        Kind.WHEEL_SPEED: _sensor(config, ("speed",), (config.wheel_speed_sd,), car.speed_gain),
        Kind.GYRO: _sensor(config, ("yaw_rate",), (config.gyro_sd,)),
    }


def residual(sensor: Sensor, measured: Array, expected: Array) -> Array:
    """Measurement minus expectation, the yaw wrapped to [-pi, pi]."""
    difference: Array = measured - expected
    if sensor.yaw_row is not None:
        difference[sensor.yaw_row] = math.remainder(difference[sensor.yaw_row], math.tau)
    return difference


def _sensor(
    config: FilterConfig, names: tuple[str, ...], sds: tuple[float, ...], gain: float = 1.0
) -> Sensor:
    matrix = np.zeros((len(names), len(_FIELDS)))
    for row, name in enumerate(names):
        matrix[row, _FIELDS.index(name)] = 1.0 / gain
    return Sensor(
        matrix=matrix,
        noise=np.diag(np.square(sds)),
        gate=chi_square_gate(len(names), config.gate_probability),
        yaw_row=names.index("yaw") if "yaw" in names else None,
    )
