"""The single-track (bicycle) chassis of the paper: linear tyres, small slip angles.

Source: CommonRoad vehicle models, single-track (ST) model, which the paper's code integrates, with
vertical loads shifted by longitudinal acceleration. Below walking pace the slip angles lose meaning
(division by speed): the model passes smoothly into the kinematic one, as CommonRoad's does
abruptly.
"""

# Why: docs/decisions/vehicle-model.md#d5

from steerd.car_model.chassis import (
    KINEMATIC_RATE,
    SPEED_KINEMATIC,
    Axles,
    Chassis,
    Rates,
    dynamic_share,
    rolling,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car
from steerd.car_model.state import State


def slip_angles(ops: Ops[T], car: Car[T], state: State[T], wheel: T, accel: T) -> Axles[T]:
    """Slip angle of each axle [rad], small-angle form; `wheel` is the road-wheel angle [rad]."""
    spin = state.yaw_rate / ops.maximum(state.speed, SPEED_KINEMATIC)
    slip = state.slip_angle
    return Axles(wheel - slip - car.lf * spin, car.lr * spin - slip)


def axle_loads(ops: Ops[T], car: Car[T], state: State[T], accel: T) -> Axles[T]:
    """Vertical load of each axle [N] at longitudinal acceleration `accel` [m/s^2]."""
    return loads_at(car, accel)


def loads_at(car: Car[T], accel: T) -> Axles[T]:
    """Vertical load of each axle [N] of a body that accelerates along its x axis [m/s^2]."""
    lf, lr = car.lf, car.lr
    per_metre = car.mass / (lf + lr)
    shift = accel * car.cog_height
    return Axles(per_metre * (GRAVITY * lr - shift), per_metre * (GRAVITY * lf + shift))


def chassis_rates(
    ops: Ops[T], car: Car[T], state: State[T], wheel: T, accel: T, loads: Axles[T], forces: Axles[T]
) -> Rates[T]:
    """Newton and Euler for the planar body, blended into the kinematic car at crawling speed."""
    speed, yaw_rate, slip = state.speed, state.yaw_rate, state.slip_angle
    share = dynamic_share(ops, speed)
    heavy = car.mass * ops.maximum(speed, SPEED_KINEMATIC)
    yaw_accel = (car.lf * forces.front - car.lr * forces.rear) / car.inertia_z
    slip_rate = (forces.front + forces.rear) / heavy - yaw_rate
    slow = rolling(ops, car, speed, wheel)
    crawl = (1.0 - share) * KINEMATIC_RATE
    course = state.yaw + slip
    return Rates(
        speed * ops.cos(course),
        speed * ops.sin(course),
        yaw_rate,
        accel,
        share * yaw_accel + crawl * (slow.yaw_rate - yaw_rate),
        share * slip_rate + crawl * (slow.slip_angle - slip),
    )


SINGLE_TRACK = Chassis("single_track", "", slip_angles, axle_loads, chassis_rates)
