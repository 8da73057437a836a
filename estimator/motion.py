"""Propagation of a belief in Python: the reference that the compiled filter is compared with.

The equations are `car_model.prediction`'s, evaluated number by number.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from steerd.car_model.chassis import Chassis
from steerd.car_model.params import Car
from steerd.car_model.prediction import (
    LONGEST_STEP_NS,
    MOST_STEPS,
    SIZE,
    STEEPEST,
    ActuatorMotion,
    recorded_step,
)
from steerd.car_model.state import State
from steerd.car_model.tape import Tape, program
from steerd.estimator.actuation import SECONDS, History, drive
from steerd.estimator.belief import Array, Belief
from steerd.estimator.config import FilterConfig

if TYPE_CHECKING:
    from steerd.estimator.kalman import Kalman


class Propagation(NamedTuple):
    """A step's outcome."""

    mean: Array
    """(7,) after it."""
    transition: Array
    """(7, 7): its Jacobian by the mean before, `F`."""
    noise: Array
    """(7, 7): covariance that entered during it, `Q`."""


def noise_density(config: FilterConfig, *, steered: bool = True) -> list[float]:
    """Spectral densities of the states' unmodelled rates (7,), squared units per second.

    Of the slip angle the root of the lateral acceleration's, which a step divides by the speed. A
    servo that nothing drives stays where it is.
    """
    return [
        config.position_density**2,
        config.position_density**2,
        config.yaw_density**2,
        config.longitudinal_accel_density**2,
        config.yaw_accel_density**2,
        config.lateral_accel_density,
        config.steer_rate_density**2 if steered else 0.0,
    ]


@lru_cache(maxsize=32)
def _program(car: Car[float], chassis: Chassis) -> Callable[..., tuple[float, ...]]:
    """A step for this car, recorded."""
    tape = Tape()
    return program(*recorded_step(tape, Car(*map(tape.constant, car)), chassis))


def propagate(
    car: Car[float],
    chassis: Chassis,
    state: State[float],
    driven: ActuatorMotion,
    density: Sequence[float],
    h: float,
) -> Propagation:
    """One step of `h` seconds from a mean, under what the actuators do and noise of `density`."""
    numbers = np.array(_program(car, chassis)(*state, *driven[:-1], *density, h))
    matrices = numbers[SIZE:].reshape(2, SIZE, SIZE)
    return Propagation(numbers[:SIZE], matrices[0], matrices[1])


def predict_belief(
    kalman: "Kalman",
    car: Car[float],
    chassis: Chassis,
    config: FilterConfig,
    history: History,
    belief: Belief,
    start_ns: int,
    end_ns: int,
) -> Belief:
    """The belief moved from `start_ns` to `end_ns` under the commands of the history.

    The division into steps depends on the two instants alone, so that fusing the same measurements
    in any order of arrival takes the same steps. In a gap that is too long for short steps they
    grow: what is fast fades in the first ones.
    """
    span = end_ns - start_ns
    count = min(-(-span // LONGEST_STEP_NS), MOST_STEPS)
    power = 1
    while power < STEEPEST and span > LONGEST_STEP_NS * count**power:
        power += 1
    begin = start_ns
    for i in range(1, count + 1):
        end = start_ns + span * i**power // count**power
        belief = _step(kalman, car, chassis, config, history, belief, begin, end)
        begin = end
    return belief


def _step(
    kalman: "Kalman",
    car: Car[float],
    chassis: Chassis,
    config: FilterConfig,
    history: History,
    belief: Belief,
    begin: int,
    end: int,
) -> Belief:
    """One step."""
    h = (end - begin) * SECONDS
    state: State[float] = State(*belief.mean.tolist())
    driven = drive(car, history, state.steer, state.speed, begin, end)
    density = noise_density(config, steered=driven.steered)
    return kalman.predict(belief, *propagate(car, chassis, state, driven, density, h))
