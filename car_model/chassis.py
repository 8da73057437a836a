"""What a chassis is: from actuators to accelerations, by the tyres' slip, load and force.

Two chassis share effects and actuators: `single_track` (the paper's, small angles) and `planar`
(exact angles, forces in the wheel's frame, slip of the driven wheels). A chassis is written as the
chain slips -> loads -> forces -> rates, so that an unmodelled effect can touch one link.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple

from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State

SPEED_KINEMATIC = 0.2  # at and below this speed the car follows its wheels without slip [m/s]
SPEED_DYNAMIC = 0.5  # at and above this speed the tyre equations hold alone [m/s]
KINEMATIC_RATE = 50.0
"""How fast yaw rate and slip settle on the kinematic values at crawling speed [1/s]."""


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


SlipAngles = Callable[[Ops[T], Car[T], State[T], T, T], Axles[T]]
"""(ops, car, state, wheel, accel): slip angle of each axle [rad] at a road-wheel angle [rad]."""
AxleLoads = Callable[[Ops[T], Car[T], State[T], T], Axles[T]]
"""(ops, car, state, accel): vertical load of each axle [N]."""
ChassisRates = Callable[[Ops[T], Car[T], State[T], T, T, Axles[T], Axles[T]], Rates[T]]
"""(ops, car, state, wheel, accel, loads, forces): rates of the chassis states."""


@dataclass(frozen=True)
class Chassis:
    """The equations of a planar body on two axles. Name and drive say which: they alone compare."""

    name: str  # as the car file says it
    # Which wheels the motor turns, `rear`, `front` or `all`; empty where the equations do not ask
    drive: str
    slip_angles: SlipAngles[Any] = field(compare=False)  # from state to slip angles
    axle_loads: AxleLoads[Any] = field(compare=False)  # from state to loads
    rates: ChassisRates[Any] = field(compare=False)  # from loads and forces to rates

    @property
    def label(self) -> str:
        """Name and drive in one word, for caches: `planar_all`."""
        return f"{self.name}_{self.drive}" if self.drive else self.name


def lateral_forces(car: Car[T], slips: Axles[T], loads: Axles[T]) -> Axles[T]:
    """Linear tyres: force of each axle [N], positive to the left, across its wheels."""
    mu = car.mu
    return Axles(mu * car.c_sf * loads.front * slips.front, mu * car.c_sr * loads.rear * slips.rear)


def dynamic_share(ops: Ops[T], speed: T) -> T:
    """Weight of the tyre equations against the kinematic ones: 0 crawling, 1 driving (C1)."""
    s = ops.clip((speed - SPEED_KINEMATIC) / (SPEED_DYNAMIC - SPEED_KINEMATIC), 0.0, 1.0)
    share: T = s * s * (3.0 - 2.0 * s)
    return share


class Rolling(NamedTuple, Generic[T]):
    """A car that follows its wheels without slip."""

    yaw_rate: T  # [rad/s]
    slip_angle: T  # of the CoG [rad]


def rolling(ops: Ops[T], car: Car[T], speed: T, wheel: T) -> Rolling[T]:
    """The kinematic single-track car: the rear axle moves along the body, the front along a wheel.

    Source: Rajamani, Vehicle Dynamics and Control, section 2.2.
    """
    base = car.lf + car.lr
    tangent = ops.tan(wheel)
    slip = ops.atan(car.lr * tangent / base)
    return Rolling(speed * ops.cos(slip) * tangent / base, slip)


def derivative(
    chassis: Chassis, ops: Ops[T], car: Car[T], state: State[T], wheel: T, accel: T
) -> Rates[T]:
    """Rates of the chassis states for a road-wheel angle [rad] and acceleration [m/s^2]."""
    slips = chassis.slip_angles(ops, car, state, wheel, accel)
    loads = chassis.axle_loads(ops, car, state, accel)
    forces = lateral_forces(car, slips, loads)
    return chassis.rates(ops, car, state, wheel, accel, loads, forces)
