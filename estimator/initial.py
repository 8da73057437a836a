"""The first belief: a straight line through the first poses, standing or moving.

One pose says nothing about speed, and an extended Kalman filter started with a wrong speed
linearises in the wrong place. A line through some ten poses gives velocity and yaw rate with their
uncertainty, and its residuals show whether those poses agree at all.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.chassis import SPEED_DYNAMIC
from steerd.car_model.prediction import SIZE
from steerd.car_model.state import State
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import Measurement, chi_square_above
from steerd.steer_bus.quick_values import quick_value

Array = NDArray[np.float64]
SECONDS = 1e-9
LONGEST_S = 0.5  # poses further apart than this do not start a filter together [s]
_ACCEL = 5.0  # the car may accelerate this much while the poses are taken [m/s^2]
_YAW_ACCEL = 20.0  # and turn up its yaw rate this much [rad/s^2]
_SLIP_LARGEST = 0.5  # beyond this the car is carried, not driven [rad]
_SLIP_SD, _STEER_SD, _STEER_SD_UNKNOWN = 0.1, 0.05, 0.2


@quick_value
class Belief:
    """A Gaussian belief about the state, as the library reads and writes it."""

    numbers: bytes  # mean (n,), in the order of `State`, then the covariance (n, n), row by row

    @property
    def mean(self) -> Array:
        """Of each state, (n,)."""
        return np.frombuffer(self.numbers)[:SIZE]

    @property
    def covariance(self) -> Array:
        """(n, n), symmetric."""
        return np.frombuffer(self.numbers)[SIZE:].reshape(SIZE, SIZE)


def make_belief(mean: Array, covariance: Array) -> Belief:
    """The belief with this mean (n,) and covariance (n, n)."""
    return Belief(np.array(mean, np.float64).tobytes() + np.array(covariance, np.float64).tobytes())


def initial_belief(
    config: FilterConfig, poses: Sequence[Measurement], steer: float | None
) -> Belief | None:
    """Belief at the last of the poses (in order of time), or None if they do not lie on a line.

    The steering was sent to `steer` [rad], None when nobody knows.
    """
    t = np.array([(pose.t_ns - poses[-1].t_ns) * SECONDS for pose in poses])
    values = np.array([pose.values for pose in poses])
    values[:, 2] = np.unwrap(values[:, 2])
    span = float(-t[0])
    if not 0.0 < span <= LONGEST_S:
        return None
    bend = np.array([_ACCEL, _ACCEL, _YAW_ACCEL])
    sds = np.array([config.pose_position_sd, config.pose_position_sd, config.pose_yaw_sd])
    # A parabola a t^2 / 2 leaves its chord by a span^2 / 8, to both sides of the fitted line.
    noise = sds**2 + (bend * span**2 / 16.0) ** 2
    design = np.column_stack([np.ones_like(t), t])
    inverse = np.linalg.inv(design.T @ design)
    fit = inverse @ design.T @ values
    misfit = float((((values - design @ fit) ** 2) / noise).sum())
    if chi_square_above(3 * (len(poses) - 2), misfit) < 1.0 - config.gate_probability:
        return None
    variance = np.outer(np.diag(inverse), noise)
    variance[1] += (0.5 * bend * span) ** 2
    return _belief(fit, variance, steer)


def _belief(fit: Array, variance: Array, steer: float | None) -> Belief:
    """From line fits (2, 3): row 0 is (x, y, yaw) at the end, row 1 their rates."""
    (x, y, yaw), (vx, vy, yaw_rate) = fit.tolist()
    speed, slip, slip_variance = _motion(yaw, vx, vy, float(variance[1, 0]))
    state = State(x, y, yaw, speed, yaw_rate, slip, steer if steer is not None else 0.0)
    spread = State(
        x=variance[0, 0],
        y=variance[0, 1],
        yaw=variance[0, 2],
        speed=variance[1, 0],
        yaw_rate=variance[1, 2],
        slip_angle=slip_variance + variance[0, 2],
        steer=(_STEER_SD if steer is not None else _STEER_SD_UNKNOWN) ** 2,
    )
    return make_belief(np.array(state), np.diag(np.array(spread)))


def _motion(yaw: float, vx: float, vy: float, variance: float) -> tuple[float, float, float]:
    """Speed, slip angle and its variance from a velocity; a crawling car is taken to roll."""
    along = vx * math.cos(yaw) + vy * math.sin(yaw)
    speed = math.copysign(math.hypot(vx, vy), along)
    sign = math.copysign(1.0, along)
    slip = math.remainder(math.atan2(sign * vy, sign * vx) - yaw, math.tau)
    if abs(speed) < SPEED_DYNAMIC or abs(slip) > _SLIP_LARGEST:
        return along, 0.0, _SLIP_SD**2
    return speed, slip, variance / speed**2
