"""The single-track (bicycle) equations, component by component.

Source: CommonRoad vehicle models, single-track (ST) model, which the paper's code integrates:
linear tyres, small slip angles, vertical loads shifted by longitudinal acceleration. The equations
are written as the chain slips -> loads -> forces -> rates, so that an unmodelled effect can touch
one link. Below walking pace the slip angles lose meaning (division by speed): the model passes
smoothly into the kinematic one, as CommonRoad's does abruptly.
"""

from typing import Generic, NamedTuple

from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car
from steerd.car_model.state import Command, State

SPEED_KINEMATIC = 0.2
"""At and below this speed the car follows its wheels without slip [m/s]."""
SPEED_DYNAMIC = 0.5
"""At and above this speed the tyre equations hold alone [m/s]."""
KINEMATIC_RATE = 50.0
"""How fast yaw rate and slip settle on the kinematic values at crawling speed [1/s]."""
LAG_FLOOR = 1e-6
"""A lag below this is none: exp(-h / LAG_FLOOR) is zero for every step size in use [s]."""


class Axles(NamedTuple, Generic[T]):
    """A quantity of the front and the rear axle: slip angle [rad], load or force [N]."""

    front: T
    rear: T


class Rates(NamedTuple, Generic[T]):
    """Time derivatives of the chassis states."""

    x: T
    y: T
    yaw: T
    speed: T
    yaw_rate: T
    slip_angle: T


class Actuated(NamedTuple, Generic[T]):
    """What the actuators do within one step: end angle [rad] and constant acceleration [m/s^2]."""

    steer: T
    accel: T


def references(ops: Ops[T], car: Car[T], command: Command[T]) -> Command[T]:
    """What the actuators aim at: the command through the car's gains, bias and end stops."""
    steer = car.steer_gain * command.steer + car.steer_bias
    return Command(
        ops.clip(steer, car.steer_min, car.steer_max),
        car.speed_gain * command.speed,
    )


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


def slip_angles(ops: Ops[T], car: Car[T], state: State[T], wheel: T) -> Axles[T]:
    """Slip angle of each axle [rad], small-angle form; `wheel` is the road-wheel angle [rad]."""
    spin = state.yaw_rate / ops.maximum(state.speed, SPEED_KINEMATIC)
    slip = state.slip_angle
    return Axles(wheel - slip - car.lf * spin, car.lr * spin - slip)


def axle_loads(car: Car[T], accel: T) -> Axles[T]:
    """Vertical load of each axle [N] at longitudinal acceleration `accel` [m/s^2]."""
    lf, lr = car.lf, car.lr
    per_metre = car.mass / (lf + lr)
    shift = accel * car.cog_height
    return Axles(per_metre * (GRAVITY * lr - shift), per_metre * (GRAVITY * lf + shift))


def lateral_forces(car: Car[T], slips: Axles[T], loads: Axles[T]) -> Axles[T]:
    """Linear tyres: force of each axle [N], positive to the left."""
    mu = car.mu
    return Axles(mu * car.c_sf * loads.front * slips.front, mu * car.c_sr * loads.rear * slips.rear)


def dynamic_share(ops: Ops[T], speed: T) -> T:
    """Weight of the tyre equations against the kinematic ones: 0 crawling, 1 driving (C1)."""
    s = ops.clip((speed - SPEED_KINEMATIC) / (SPEED_DYNAMIC - SPEED_KINEMATIC), 0.0, 1.0)
    share: T = s * s * (3.0 - 2.0 * s)
    return share


def chassis_rates(
    ops: Ops[T], car: Car[T], state: State[T], wheel: T, accel: T, forces: Axles[T]
) -> Rates[T]:
    """Newton and Euler for the planar body, blended into the kinematic car at crawling speed."""
    speed, yaw_rate, slip = state.speed, state.yaw_rate, state.slip_angle
    base = car.lf + car.lr
    share = dynamic_share(ops, speed)
    heavy = car.mass * ops.maximum(speed, SPEED_KINEMATIC)
    yaw_accel = (car.lf * forces.front - car.lr * forces.rear) / car.inertia_z
    slip_rate = (forces.front + forces.rear) / heavy - yaw_rate
    tangent = ops.tan(wheel)
    slip_rolling = ops.atan(car.lr * tangent / base)
    yaw_rate_rolling = speed * ops.cos(slip_rolling) * tangent / base
    crawl = (1.0 - share) * KINEMATIC_RATE
    course = state.yaw + slip
    return Rates(
        speed * ops.cos(course),
        speed * ops.sin(course),
        yaw_rate,
        accel,
        share * yaw_accel + crawl * (yaw_rate_rolling - yaw_rate),
        share * slip_rate + crawl * (slip_rolling - slip),
    )


def derivative(ops: Ops[T], car: Car[T], state: State[T], wheel: T, accel: T) -> Rates[T]:
    """Rates of the chassis states for a road-wheel angle [rad] and acceleration [m/s^2]."""
    slips = slip_angles(ops, car, state, wheel)
    forces = lateral_forces(car, slips, axle_loads(car, accel))
    return chassis_rates(ops, car, state, wheel, accel, forces)
