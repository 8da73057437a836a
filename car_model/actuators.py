"""Steering servo and speed loop: gains, end stops, first-order lags with slew limits."""

# Why: docs/decisions/vehicle-model.md#d4

from typing import Generic, NamedTuple

from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import Command, State

LAG_FLOOR = 1e-6
"""A lag below this is none: exp(-h / LAG_FLOOR) is zero for every step size in use [s]."""


class Actuated(NamedTuple, Generic[T]):
    """What the actuators do within one step: end angle [rad] and constant acceleration [m/s^2]."""

    steer: T
    accel: T


def references(ops: Ops[T], car: Car[T], command: Command[T]) -> Command[T]:
    """What the actuators aim at: the command through the car's gains, bias and end stops."""
    steer = car.steer_gain * command.steer + car.steer_bias
    return Command(ops.clip(steer, car.steer_min, car.steer_max), car.speed_gain * command.speed)


def actuate(ops: Ops[T], car: Car[T], state: State[T], ref: Command[T], h: float) -> Actuated[T]:
    """First-order lags with slew limits, solved exactly over a step of `h` seconds.

    The exact solution keeps the step stable however short a lag is, down to none at all.
    """
    steer_move = (ref.steer - state.steer) * (
        1.0 - ops.exp(-h / ops.maximum(car.steer_lag, LAG_FLOOR))
    )
    speed_gap = ref.speed - state.speed
    accel = speed_gap * (1.0 - ops.exp(-h / ops.maximum(car.speed_lag, LAG_FLOOR))) / h
    limit = car.steer_rate * h
    return Actuated(
        state.steer + ops.clip(steer_move, -limit, limit),
        ops.clip(accel, -car.decel_max, car.accel_max),
    )
