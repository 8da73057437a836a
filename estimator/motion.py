"""How a belief moves: the single-track equations and their exact Jacobian, one implicit step.

The linearly implicit midpoint rule (Rosenbrock's, one stage) with `A` the Jacobian of the rates:

    x+ = x + h W f(x),   F = 2 W - I = (I - h A / 2)^-1 (I + h A / 2),   W = (I - h A / 2)^-1

is of second order and stable however fast yaw rate and slip decay (about 94 / v per second for the
paper's car, which an explicit step of 10 ms no longer follows below 0.5 m/s). One evaluation of
the equations and one 6x6 inverse serve mean and covariance alike.
"""

import math
from itertools import pairwise

import numpy as np

from car_model.jacobian_generated import rates_and_jacobian
from car_model.params import Car
from car_model.single_track import SPEED_DYNAMIC
from car_model.state import State
from estimator.actuation import SECONDS, Driven, History, drive
from estimator.config import FilterConfig
from estimator.kalman import Array, Belief, Kalman

SIZE = len(State._fields)
SPEED, STEER = State._fields.index("speed"), State._fields.index("steer")
LONGEST_STEP_NS = 10_000_000
MOST_STEPS = 25
"""A gap without any measurement is divided no finer: a tick must stay cheap however long it is."""
_CHASSIS = SIZE - 1
_IDENTITY = np.eye(_CHASSIS)


def noise_density(config: FilterConfig, speed: float) -> Array:
    """Spectral densities of the states' unmodelled rates (7,), squared units per second.

    A lateral acceleration turns the velocity by `a / v`; below `SPEED_DYNAMIC` the tyres no longer
    decide, and the divisor stays there.
    """
    slip = config.lateral_accel_density / max(abs(speed), SPEED_DYNAMIC)
    density = (
        config.position_density,
        config.position_density,
        config.yaw_density,
        config.longitudinal_accel_density,
        config.yaw_accel_density,
        slip,
        config.steer_rate_density,
    )
    return np.array([d * d for d in density])


def moved_mean(car: Car[float], mean: Array, driven: Driven, h: float) -> tuple[Array, Array]:
    """The mean (7,) after `h` seconds, and its Jacobian (7, 7) by the mean before."""
    state = State(*mean.tolist())
    rates, rows = rates_and_jacobian(car, state, driven.wheel, driven.accel)
    jacobian = np.array(rows)
    implicit = np.linalg.inv(_IDENTITY - (0.5 * h) * jacobian[:, :_CHASSIS])
    after = np.empty(SIZE)
    after[:_CHASSIS] = mean[:_CHASSIS] + h * (implicit @ np.array(rates))
    after[STEER] = driven.steer
    by_inputs = h * (implicit @ jacobian[:, _CHASSIS:])
    transition = np.zeros((SIZE, SIZE))
    transition[:_CHASSIS, :_CHASSIS] = 2.0 * implicit - _IDENTITY
    transition[:_CHASSIS, SPEED] += by_inputs[:, 1] * driven.accel_by_speed
    transition[:_CHASSIS, STEER] = by_inputs[:, 0] * driven.wheel_by_steer
    transition[STEER, STEER] = driven.steer_by_steer
    return after, transition


def predicted(
    kalman: Kalman,
    car: Car[float],
    config: FilterConfig,
    history: History,
    belief: Belief,
    start_ns: int,
    end_ns: int,
) -> Belief:
    """The belief moved from `start_ns` to `end_ns` under the commands of the history.

    The division into steps depends on the two instants alone, so that fusing the same measurements
    in any order of arrival takes the same steps.
    """
    span = end_ns - start_ns
    count = min(math.ceil(span / LONGEST_STEP_NS), MOST_STEPS)
    marks = [start_ns + span * i // count for i in range(count + 1)] if count else []
    for begin, end in pairwise(marks):
        belief = _step(kalman, car, config, history, belief, begin, end)
    return belief


def _step(
    kalman: Kalman,
    car: Car[float],
    config: FilterConfig,
    history: History,
    belief: Belief,
    begin: int,
    end: int,
) -> Belief:
    """One step; half of its noise comes before the motion and half after (second order)."""
    h = (end - begin) * SECONDS
    mean = belief.mean
    driven = drive(car, history, float(mean[STEER]), float(mean[SPEED]), begin, end)
    after, transition = moved_mean(car, mean, driven, h)
    before = np.diag((0.5 * h) * noise_density(config, float(mean[SPEED])))
    added = np.diag((0.5 * h) * noise_density(config, float(after[SPEED])))
    noisy = Belief(mean, belief.covariance + before)
    return kalman.predict(noisy, after, transition, added)
