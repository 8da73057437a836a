"""Closed forms of the linear single-track car, to hold the product's equations against.

Source: Rajamani, Vehicle Dynamics and Control, sections 2.5 and 3.3, with stiffness per axle.
"""

import numpy as np

from steerd.car_model.chassis import Chassis, derivative
from steerd.car_model.params import GRAVITY, Car, wheelbase
from steerd.car_model.state import State
from steerd.car_model.tape import TAPE, Tape, jacobian, program
from steerd.estimator.config import FilterConfig


def axle_stiffness(car: Car[float]) -> tuple[float, float]:
    """Cornering stiffness per axle `(cf, cr)` [N/rad] at rest load: `mu C_S F_z`."""
    scale = car.mu * car.mass * GRAVITY / wheelbase(car)
    return scale * car.lr * car.c_sf, scale * car.lf * car.c_sr


def feedforward_steer(car: Car[float], speed: float, curvature: float) -> float:
    """Road-wheel angle [rad] that holds a path curvature [1/m]: `L k + K_us v^2 k`.

    `K_us = (m / L) (lr / cf - lf / cr)` with per-axle stiffness; mass and load cancel.
    """
    understeer = (1.0 / car.c_sf - 1.0 / car.c_sr) / (car.mu * GRAVITY)
    return (wheelbase(car) + understeer * speed * speed) * curvature


def steady_slip(car: Car[float], speed: float, curvature: float) -> float:
    """Slip angle [rad] of the steady turn: `lr k - v^2 k / (mu g C_Sr)`."""
    return (car.lr - speed * speed / (car.mu * GRAVITY * car.c_sr)) * curvature


def noise_densities(config: FilterConfig, speed: float) -> np.ndarray:
    """White noise of each state at a speed, as the filter's settings say it."""
    return np.array([
        *(config.position_density,) * 2, config.yaw_density, config.longitudinal_accel_density,
        config.yaw_accel_density, config.lateral_accel_density / max(abs(speed), 0.5),
        config.steer_rate_density,
    ])  # fmt: skip


def rates_and_slopes(
    chassis: Chassis, car: Car[float], state: State[float], wheel: float, accel: float
) -> tuple[np.ndarray, np.ndarray]:
    """The six rates of a chassis and their (6, 8) derivatives by states, wheel and acceleration."""
    tape = Tape()
    inputs = [tape.symbol(f"s{i}") for i in range(9)]
    constants = car._make(map(tape.constant, car))
    rates = derivative(chassis, TAPE, constants, State(*inputs[:7]), *inputs[7:])
    slopes = jacobian(rates, (*inputs[:6], *inputs[7:]))
    outputs = [tape.node(number) for row in (rates, *slopes) for number in row]
    numbers = np.array(program(inputs, outputs)(*state, wheel, accel))
    return numbers[:6], numbers[6:].reshape(6, 8)
