"""The car in MuJoCo, driven step by step."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import atan, atan2, exp, hypot, sin, sqrt, tan, tanh
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_gap.drives import LEAD
from benchmarks.blind_gap.effects import Place, Values
from benchmarks.blind_gap.plant import STEP
from benchmarks.foreign_cars.drives import Commands
from benchmarks.foreign_cars.effects import WIRED, WIRED_OUTSIDE
from benchmarks.foreign_cars.log import Log
from benchmarks.foreign_cars.mjcf import MujocoCar, draw_car, make_model, rest_loads
from benchmarks.foreign_cars.tyre import tyre_forces
from benchmarks.foreign_cars.wiring import (
    Orders,
    Wiring,
    draw_wiring,
    make_orders,
    make_push,
    observe,
)

Array = NDArray[np.float64]
Change = Callable[[MujocoCar, Values], MujocoCar]

_EDGE = 0.05
"""Half width of a patch's edge [m]."""
_SLOW = 0.5
"""Pushes fade out below this speed [m/s]."""


@dataclass(frozen=True, slots=True)
class Path:
    """What happened, each millisecond.

    Attributes:
        poses: rows x, y, yaw (continuous) of the chassis frame.
        velocity: rows of the chassis' velocity in the world, x and y, and yaw rate.
        rolling: surface speed of the driven wheels, by their turning [m/s].
        loads: wheel loads [N].
    """

    poses: Array
    velocity: Array
    rolling: Array
    loads: Array


@dataclass(frozen=True, slots=True)
class MujocoPlant:
    """Plant b: a car in MuJoCo, on its own contacts or on tyres with a slip angle."""

    car: MujocoCar
    wiring: Wiring

    @property
    def effects(self) -> frozenset[str]:
        """Effects that it can have."""
        slip = frozenset() if self.car.contact else frozenset(("tyre_relaxation",))
        return frozenset(WIRED) | frozenset(_EFFECTS) | slip

    @property
    def outside(self) -> frozenset[str]:
        """Defects outside the library that it can have."""
        return frozenset(WIRED_OUTSIDE) | frozenset(_OUTSIDE)

    @property
    def truth(self) -> Values:
        """Lengths [m], yaw inertia [kg m^2], cornering force per load and slip angle [1/rad].

        Contacts creep with a slip velocity: they have no cornering force per slip angle to name.
        """
        car = self.car
        lengths = {"lf": car.lf, "lr": car.lr, "inertia_z": car.inertia_z}
        stiff = {"front": car.tyre.stiff_front, "rear": car.tyre.stiff_rear}
        return lengths if car.contact else lengths | stiff

    def with_effect(self, name: str, values: Values) -> "MujocoPlant":
        """The car with an effect of the contract."""
        if name in WIRED:
            return replace(self, wiring=WIRED[name](self.wiring, values))
        plant = replace(self, car=(_EFFECTS | _SLIP_EFFECTS)[name](self.car, values))
        if name == "cog_offset":
            marker = plant.wiring.marker_x - values["offset"]
            plant = replace(plant, wiring=plant.wiring._replace(marker_x=marker))
        return plant

    def with_outside(self, name: str, strength: float, place: Place) -> "MujocoPlant":
        """The car with a defect that no effect describes."""
        if name in WIRED_OUTSIDE:
            wiring = self.wiring._replace(**{WIRED_OUTSIDE[name]: strength})
            return replace(self, wiring=wiring)
        sign = place.sign if name == "left_right_tyres" else 1.0
        return replace(self, car=self.car._replace(**{_OUTSIDE[name]: sign * strength}))

    def drive(self, commands: Commands, rng: np.random.Generator) -> Log:
        """Drive it and record."""
        orders = make_orders(self.wiring, commands, rng)
        push = make_push(commands, rng)
        path = simulate(self.car, self.wiring, orders, push.process, commands.start)
        return observe(self.wiring, commands, path.poses, path.rolling, push.pose, rng)


def make_mujoco(contact: bool, rng: np.random.Generator) -> MujocoPlant:
    """A healthy car, on MuJoCo's contacts or on tyres with a slip angle."""
    return MujocoPlant(draw_car(contact, rng), draw_wiring(rng))


def _grip(car: MujocoCar, ratio: float) -> MujocoCar:
    """Friction of all tyres scaled: of the geoms' pairs with the floor, or of the tyre."""
    return car._replace(tyre=car.tyre._replace(mu=ratio * car.tyre.mu))


def _stiffness(car: MujocoCar, front: float, rear: float) -> MujocoCar:
    """Cornering stiffness of the axles scaled; contacts creep by a time constant."""
    tyre = car.tyre._replace(
        stiff_front=front * car.tyre.stiff_front, stiff_rear=rear * car.tyre.stiff_rear
    )
    return car._replace(
        tyre=tyre, creep_front=car.creep_front / front, creep_rear=car.creep_rear / rear
    )


def _relaxed(car: MujocoCar, values: Values) -> MujocoCar:
    length = car.tyre.relaxation + values["length"]
    return car._replace(tyre=car.tyre._replace(relaxation=length))


def _add(attribute: str, parameter: str) -> Change:
    return lambda car, v: car._replace(**{attribute: getattr(car, attribute) + v[parameter]})


_EFFECTS: Mapping[str, Change] = {
    "rolling_drag": _add("drag", "drag"),
    "tyre_friction": lambda car, v: _grip(car, v["ratio"]),
    "cornering_stiffness": lambda car, v: _stiffness(car, v["ratio"], v["ratio"]),
    "tyre_balance": lambda car, v: _stiffness(car, sqrt(v["ratio"]), 1.0 / sqrt(v["ratio"])),
    "grip_drift": _add("grip_rate", "rate"),
    "grip_patch": lambda car, v: car._replace(**{f"patch_{k}": value for k, value in v.items()}),
    "scrub": _add("differential", "yaw_damping"),
    "mass": _add("payload", "payload"),
    "cog_offset": lambda car, v: car._replace(lf=car.lf - v["offset"], lr=car.lr + v["offset"]),
    "yaw_inertia": lambda car, v: car._replace(inertia_z=v["ratio"] * car.inertia_z),
    "floor_slope": lambda car, v: car._replace(slope_x=v["x"], slope_y=v["y"]),
}
_SLIP_EFFECTS: Mapping[str, Change] = {"tyre_relaxation": _relaxed}
_OUTSIDE: Mapping[str, str] = {
    "wheel_wobble": "wobble",
    "left_right_tyres": "left",
    "loose_knuckle": "loose",
    "corner_brake": "corner_brake",
}


def wheel_angles(car: MujocoCar, angle: float) -> tuple[float, float]:
    """Angles of the left and the right front wheel, by the linkage [rad]."""
    bend = tan(angle) * car.ackermann * 0.5 * car.track / (car.lf + car.lr)
    return atan(tan(angle) / (1.0 - bend)), atan(tan(angle) / (1.0 + bend))


def grip_at(car: MujocoCar, x: float, y: float, t: float) -> float:
    """Friction of the floor at a place and time, per nominal."""
    inside = 0.5 * (
        1.0 - tanh((hypot(x - car.patch_x, y - car.patch_y) - car.patch_radius) / _EDGE)
    )
    return exp(car.grip_rate * max(t, 0.0) / 60.0) * (1.0 - car.patch_drop * inside)


def _start(model: Any, car: MujocoCar, start: Array) -> Any:
    """Data of the car rolling at the start."""
    data = mujoco.MjData(model)
    x, y, yaw, speed = start
    data.qpos[:3] = x, y, car.height
    data.qpos[3:7] = np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)
    data.qvel[:2] = speed * np.cos(yaw), speed * np.sin(yaw)
    for joint in ("spin_fl", "spin_fr", "spin_rl", "spin_rr"):
        data.qvel[model.joint(joint).dofadr[0]] = speed / car.radius
    return data


class Stepper:
    """A car on the move: one millisecond after the other."""

    def __init__(self, car: MujocoCar, wiring: Wiring, start: Array) -> None:
        model = make_model(car, wiring.drive_lag, min(wiring.accel_max, wiring.brake_max))
        self.car, self.model, self.data = car, model, _start(model, car, start)
        names = ("fl", "fr", "rl", "rr")
        self.hubs = np.array([model.body(f"hub_{n}").id for n in names])
        self.wheels = np.array([model.body(f"wheel_{n}").id for n in names])
        self.spins = np.array([model.joint(f"spin_{n}").dofadr[0] for n in names])
        self.turns = np.array([model.joint(f"spin_{n}").qposadr[0] for n in names])
        self.driven = self.spins if car.all_driven else self.spins[2:]
        self.chassis = model.body("chassis").id
        self.mass = float(model.body_mass.sum())
        self.rest, self.slips = rest_loads(car), np.zeros((4, 2))
        self.sides = np.array([1.0 - car.left, 1.0 + car.left] * 2)
        self.forces, self.even, self.right = np.zeros((4, 3)), np.ones(4), 0.0
        self.changing = car.patch_drop != 0.0 or car.grip_rate != 0.0
        if car.contact:
            model.pair_friction[:, :2] *= self.sides[:, None]
        self.friction = model.pair_friction[:, :2].copy()

    @property
    def rolling(self) -> float:
        """Surface speed of the driven wheels [m/s]."""
        return float(self.data.qvel[self.driven].mean() * self.car.radius)

    def _command(self, angle: float, speed: float, cut: bool) -> None:
        """Set motor and servos; a loose knuckle follows only what pushes it."""
        car, data = self.car, self.data
        left, right = wheel_angles(car, angle)
        if car.loose > 0.0:
            self.right = min(max(self.right, right - 0.5 * car.loose), right + 0.5 * car.loose)
            right = self.right
        if car.wobble:
            left += car.wobble * self.rolling * sin(data.qpos[self.turns[0]])
        spin = self.data.qvel[self.driven].mean() if cut else speed / car.radius
        data.ctrl[0], data.ctrl[1], data.ctrl[2] = spin, left, right

    def _grips(self, t: float) -> Array:
        """Friction of the floor under each wheel, per nominal."""
        if not self.changing:
            return self.even
        places = self.data.xpos[self.hubs]
        return np.array([grip_at(self.car, x, y, t) for x, y, _ in places])

    def _push(self, push: Array) -> None:
        """Disturbances as a force and a moment on the chassis, along the world's axes."""
        data, car = self.data, self.car
        fade = min(hypot(data.qvel[0], data.qvel[1]) / _SLOW, 1.0)
        row = data.xfrc_applied[self.chassis]
        row[0], row[1] = fade * self.mass * push[0], fade * self.mass * push[1]
        row[5] = fade * car.inertia_z * push[2]

    def _tyres(self, t: float) -> None:
        """Forces of tyres with a slip angle on the wheels, at their contact patches."""
        data, car = self.data, self.car
        hubs = data.sensordata[:12].reshape(4, 3)
        place = data.xpos[self.hubs]
        tyre_forces(
            car.tyre, self._grips(t), self.slips, hubs[:, :2], data.sensordata[12:16], self.rest,
            data.qvel[self.spins], car.radius, self.sides, self.forces,
        )  # fmt: skip
        axes = data.xmat[self.hubs].reshape(4, 3, 3)
        ahead = axes[:, :2, 0] / np.hypot(axes[:, 0, 0], axes[:, 1, 0])[:, None]
        fx = self.forces[:, 0] * ahead[:, 0] - self.forces[:, 1] * ahead[:, 1]
        fy = self.forces[:, 0] * ahead[:, 1] + self.forces[:, 1] * ahead[:, 0]
        rows, down = data.xfrc_applied, place[:, 2]
        rows[self.wheels, 0], rows[self.wheels, 1] = fx, fy
        rows[self.wheels, 3], rows[self.wheels, 4] = down * fy, -down * fx
        rows[self.wheels, 5] = self.forces[:, 2]

    def step(self, angle: float, speed: float, cut: bool, push: Array, t: float) -> None:
        """One millisecond."""
        model, data = self.model, self.data
        self._command(angle, speed, cut)
        self._push(push)
        if self.car.contact:
            if self.changing:
                model.pair_friction[:, :2] = self._grips(t)[:, None] * self.friction
            mujoco.mj_step(model, data)
            return
        mujoco.mj_step1(model, data)
        self._tyres(t)
        mujoco.mj_step2(model, data)


def simulate(car: MujocoCar, wiring: Wiring, orders: Orders, process: Array, start: Array) -> Path:
    """Drive the car.

    Args:
        car: the car.
        wiring: motor loop and its limits.
        orders: what reaches servo and motor, per millisecond.
        process: accelerations that push it, per millisecond, rows x, y, yaw.
        start: x, y, yaw, speed.
    """
    n, stepper = len(orders.angle), Stepper(car, wiring, start)
    poses, velocity = np.empty((n, 3)), np.empty((n, 3))
    rolling, loads, data = np.empty(n), np.empty((n, 4)), stepper.data
    for i in range(n):
        w, x, y, z = data.qpos[3:7]
        poses[i] = (
            data.qpos[0],
            data.qpos[1],
            atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        )
        velocity[i] = data.qvel[0], data.qvel[1], data.qvel[5]
        rolling[i], loads[i] = stepper.rolling, data.sensordata[12:16]
        stepper.step(
            orders.angle[i], orders.speed[i], orders.cut[i] > 0.0, process[i], (i - LEAD) * STEP
        )
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(poses, velocity, rolling, loads)
