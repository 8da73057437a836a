"""The car of Gymnasium's CarRacing: four wheels in Box2D, seen from above.

The car and its physics are other people's (`gymnasium.envs.box2d.car_dynamics`); here its rear
wheels are turned and its numbers drawn, and things are made wrong with it. A wheel is pushed aside
in proportion to the speed, not the angle, at which it slips, up to a limit that no load changes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import atan, tan
from types import SimpleNamespace

import Box2D
import numpy as np
from gymnasium.envs.box2d import car_dynamics

from benchmarks.blind_gap.effects import Values
from benchmarks.blind_gap.plant import STEP
from benchmarks.foreign_cars.plants import WiredPlant
from benchmarks.foreign_cars.wiring import Array, Orders, Wiring, draw_wiring

GRAVITY = 9.81
_FRONT, _REAR, _SIDE = (
    size * car_dynamics.SIZE for size in (80.0, -82.0, 55.0)
)  # `WHEELPOS`: of the axles along, and of the wheels beside the hull's origin [units]
_ITERATIONS = 20, 10
"""Of Box2D's solver, for velocities and positions."""


@dataclass(frozen=True, slots=True)
class Box2dCar:
    """What is drawn or wrong: metres per unit, friction per the game's asphalt, share of yaw
    inertia, drag [1/s], slope of the floor."""

    unit: float
    friction: float
    inertia: float = 1.0
    drag: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0


_EFFECTS: Mapping[str, Callable[[Box2dCar, Values], Box2dCar]] = {
    "tyre_friction": lambda car, v: replace(car, friction=v["ratio"] * car.friction),
    "yaw_inertia": lambda car, v: replace(car, inertia=v["ratio"] * car.inertia),
    "rolling_drag": lambda car, v: replace(car, drag=car.drag + v["drag"]),
    "floor_slope": lambda car, v: replace(car, slope_x=v["x"], slope_y=v["y"]),
}


def _measure(car: Box2dCar) -> Values:
    centre = Model(car).centre
    return {"lf": (_FRONT - centre) * car.unit, "lr": (centre - _REAR) * car.unit}


def make_box2d(rng: np.random.Generator) -> WiredPlant[Box2dCar]:
    """A healthy car of plant e: Gymnasium's car."""
    unit, friction = rng.uniform(0.095, 0.11), rng.uniform(0.3, 0.42)
    car = Box2dCar(float(unit), float(friction))
    return WiredPlant(car, draw_wiring(rng), _EFFECTS, _measure, simulate)


class Model:
    """The car in a world of its own, in the game's units but for time.

    Attributes:
        world: of Box2D; `body` the game's car in it.
        centre: of gravity, ahead of the hull's origin.
        mass: of the whole; `inertia` of the hull about its centre.
    """

    def __init__(self, car: Box2dCar) -> None:
        pull = (-GRAVITY * car.slope_x / car.unit, -GRAVITY * car.slope_y / car.unit)
        self.world = Box2D.b2World(gravity=pull)
        self.body = car_dynamics.Car(self.world, 0.0, 0.0, 0.0)
        hull, floor = self.body.hull, SimpleNamespace(road_friction=car.friction)
        data = hull.massData
        about = data.I - data.mass * data.center.lengthSquared
        self.inertia = car.inertia * about
        hull.massData = Box2D.b2MassData(
            mass=data.mass, center=data.center, I=self.inertia + data.I - about
        )
        for wheel in self.body.wheels:
            wheel.tiles = [floor]
        parts = [hull, *self.body.wheels]
        self.mass = sum(part.mass for part in parts)
        self.centre = sum(part.mass * part.worldCenter.y for part in parts) / self.mass

    def place(self, start: Array, unit: float) -> None:
        """Let it roll from a start (x, y, yaw, speed); the game's cars point along y."""
        x, y, yaw, speed = start.tolist()
        turn = Box2D.b2Transform()
        turn.Set((0.0, 0.0), yaw - 0.5 * np.pi)
        ahead = turn * (0.0, 1.0)
        for part in (self.body.hull, *self.body.wheels):
            place = turn * part.position
            part.transform = ((place[0] + x / unit, place[1] + y / unit), yaw - 0.5 * np.pi)
            part.linearVelocity = (speed / unit * ahead[0], speed / unit * ahead[1])
        for wheel in self.body.wheels:
            wheel.omega = speed / unit / wheel.wheel_rad

    def command(self, angle: float, rolling: float, turning: float, cut: bool) -> None:
        """Turn the front wheels, each by its place, and the rear ones through a differential."""
        bend = _SIDE * tan(angle) / (_FRONT - _REAR)
        left, right, *rear = self.body.wheels
        left.steer = atan(tan(angle) / (1.0 - bend))
        right.steer = atan(tan(angle) / (1.0 + bend))
        for wheel, side in zip(rear, (-1.0, 1.0), strict=True):
            if not cut:
                wheel.omega = (rolling + side * _SIDE * turning) / wheel.wheel_rad

    @property
    def rolling(self) -> float:
        """Mean surface speed of the driven wheels."""
        return float(np.mean([wheel.omega * wheel.wheel_rad for wheel in self.body.wheels[2:]]))


def simulate(
    car: Box2dCar, wiring: Wiring, orders: Orders, process: Array, start: Array
) -> tuple[Array, Array]:
    """Drive the car.

    Returns:
        Rows x, y, yaw (continuous) of the centre of gravity, and the driven wheels' surface speed
        [m/s], each millisecond.
    """
    model, unit, n = Model(car), car.unit, len(orders.angle)
    model.place(start, unit)
    hull = model.body.hull
    path, rolling, aim = np.empty((n, 3)), np.empty(n), float(start[3])
    low, high = -wiring.brake_max * STEP, wiring.accel_max * STEP
    for i in range(n):
        x, y = hull.GetWorldPoint((0.0, model.centre))
        path[i] = x * unit, y * unit, hull.angle + 0.5 * np.pi
        rolling[i] = model.rolling * unit
        step = (orders.speed[i] - aim) * STEP / max(wiring.drive_lag, STEP)
        aim = rolling[i] if orders.cut[i] else aim + min(max(step, low), high)
        turning, cut = hull.angularVelocity, orders.cut[i] > 0.0
        model.command(float(orders.angle[i]), aim / unit, turning, cut)
        speed = hull.linearVelocity
        fade = min(speed.length * unit / 0.5, 1.0)
        push = fade * process[i] / (unit, unit, 1.0)
        force = [model.mass * float(push[k] - car.drag * speed[k]) for k in range(2)]
        hull.ApplyForce(force, (x, y), True)
        hull.ApplyTorque(model.inertia * float(push[2]), True)
        model.body.step(STEP)
        model.world.Step(STEP, *_ITERATIONS)
    return path, rolling
