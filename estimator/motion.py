"""How a belief moves: the single-track equations and their exact Jacobian, one implicit step.

The linearly implicit midpoint rule (Rosenbrock's, one stage) with `A` the Jacobian of the rates:

    x+ = x + h W f(x),   F = 2 W - I = (I - h A / 2)^-1 (I + h A / 2),   W = (I - h A / 2)^-1

is of second order and stable however fast yaw rate and slip decay (about 94 / v per second for the
paper's car, which an explicit step of 10 ms no longer follows below 0.5 m/s). One evaluation of
the equations serves mean and covariance alike.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from car_model.jacobian_generated import Jacobian, rates_and_jacobian
from car_model.params import Car
from car_model.single_track import SPEED_DYNAMIC
from car_model.state import State
from estimator.actuation import SECONDS, Driven, History, drive
from estimator.config import FilterConfig
from estimator.kalman import Array, Belief, Kalman

SIZE = len(State._fields)
LONGEST_STEP_NS = 10_000_000
MOST_STEPS = 25
"""A gap without any measurement is divided no finer: a tick must stay cheap however long it is."""
_WHEEL, _ACCEL = 6, 7
"""Columns of the inputs in `rates_and_jacobian`, after the six chassis states."""
_IDENTITY = np.eye(SIZE)
_MINUS_IDENTITY = np.diag([-1.0] * (SIZE - 1) + [0.0])

Six = tuple[float, float, float, float, float, float]


def noise_density(config: FilterConfig, speed: float, *, steered: bool = True) -> list[float]:
    """Spectral densities of the states' unmodelled rates (7,), squared units per second.

    A lateral acceleration turns the velocity by `a / v`; below `SPEED_DYNAMIC` the tyres no longer
    decide, and the divisor stays there. A servo that nothing drives stays where it is.
    """
    slip = config.lateral_accel_density / max(abs(speed), SPEED_DYNAMIC)
    return [
        config.position_density**2,
        config.position_density**2,
        config.yaw_density**2,
        config.longitudinal_accel_density**2,
        config.yaw_accel_density**2,
        slip * slip,
        config.steer_rate_density**2 if steered else 0.0,
    ]


def implicit_solver(rows: Jacobian, k: float) -> Callable[[float, float, float, float], Six]:
    """Solver of `(I - k A) z = b` for a `b` that is zero in x and y.

    Only yaw rate and slip feed back on each other; speed stands alone; yaw, then x and y, follow by
    substitution. In scalars this costs a third of a 6x6 inverse. A test holds it against the dense
    solution, which would notice an equation that couples more.
    """
    (_, _, x_yaw, x_speed, _, x_slip, *_), (_, _, y_yaw, y_speed, _, y_slip, *_) = rows[:2]
    (_, _, _, r_speed, r_r, r_slip, *_), (_, _, _, s_speed, s_r, s_slip, *_) = rows[4:]
    p, q, s, t = 1.0 - k * r_r, k * r_slip, k * s_r, 1.0 - k * s_slip
    scale = 1.0 / (p * t - q * s)

    def solve(yaw: float, speed: float, yaw_rate: float, slip: float) -> Six:
        u, w = yaw_rate + k * r_speed * speed, slip + k * s_speed * speed
        rate, beta = scale * (t * u + q * w), scale * (p * w + s * u)
        heading = yaw + k * rate
        return (
            k * (x_yaw * heading + x_speed * speed + x_slip * beta),
            k * (y_yaw * heading + y_speed * speed + y_slip * beta),
            heading,
            speed,
            rate,
            beta,
        )

    return solve


def moved_mean(
    car: Car[float], state: State[float], driven: Driven, h: float
) -> tuple[Array, Array]:
    """The mean (7,) after `h` seconds, and its Jacobian (7, 7) by the mean before."""
    rates, rows = rates_and_jacobian(car, state, driven.wheel, driven.accel)
    solve = implicit_solver(rows, 0.5 * h)
    move = solve(*rates[2:])
    after = [at + h * by for at, by in zip(state, move, strict=False)]
    after[0] += h * rates[0]
    after[1] += h * rates[1]
    # F = 2 W - I, column by column; the inputs add h W B times how they follow from the state.
    gain, turn = h * driven.accel_by_speed, h * driven.wheel_by_steer
    spin, drift = rows[4], rows[5]
    by_accel = solve(0.0, gain, gain * spin[_ACCEL], gain * drift[_ACCEL])
    columns = (
        (2.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 2.0, 0.0, 0.0, 0.0, 0.0),
        solve(2.0, 0.0, 0.0, 0.0),
        [a + b for a, b in zip(solve(0.0, 2.0, 0.0, 0.0), by_accel, strict=True)],
        solve(0.0, 0.0, 2.0, 0.0),
        solve(0.0, 0.0, 0.0, 2.0),
        solve(0.0, 0.0, turn * spin[_WHEEL], turn * drift[_WHEEL]),
    )
    transition = _MINUS_IDENTITY.copy()
    transition[:-1] += np.array(columns).T
    transition[-1, -1] = driven.steer_by_steer
    return np.array([*after, driven.steer]), transition


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
    """One step. Noise of density `D` enters all along it, carried on by an `F` that grows linearly.

    `Q = integral of (I + s (F - I)) D (I + s (F - I))' h ds = h/3 (F D F' + D) + h/6 (F D + D F')`,
    of which `F D F'` is had by adding `h/3 D` before the motion.
    """
    h = (end - begin) * SECONDS
    state = State(*belief.mean.tolist())
    driven = drive(car, history, state.steer, state.speed, begin, end)
    after, transition = moved_mean(car, state, driven, h)
    density = noise_density(config, state.speed, steered=driven.steered)
    third = _IDENTITY * [h / 3.0 * value for value in density]
    cross = 0.5 * (transition @ third)
    noisy = Belief(belief.mean, belief.covariance + third)
    return kalman.predict(noisy, after, transition, third + cross + cross.T)
