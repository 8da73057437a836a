"""The racecar that comes with Safety-Gymnasium: MuJoCo's soft contacts, a rear axle of one piece.

The car is other people's (`safety_gymnasium/assets/xmls/racecar.xml`, after MIT's racecar): here
its joints are driven, its friction drawn, and things are made wrong with it. Both front wheels turn
by the same angle. The file gives gears of some 60 g the moments of inertia of a body of half a
metre, with which no steering turns the car; they have those of their size here. The package is
read, not imported: `pip install --no-deps safety-gymnasium`.
"""

from functools import lru_cache
from importlib.util import find_spec
from math import atan2
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.blind_gap.effects import Values
from benchmarks.blind_gap.plant import STEP
from benchmarks.foreign_cars.plants import MissingPlantError, WiredPlant
from benchmarks.foreign_cars.rigid_car import EFFECTS, RigidCar
from benchmarks.foreign_cars.wiring import Array, Orders, Wiring, draw_wiring

GRAVITY = 9.81
RADIUS, REAR, WHEELBASE = 0.05, -0.16, 0.325
"""Of the file: the wheels', the rear axle's place in the car's frame, between the axles [m]."""
_WHEELS = ("left_front_wheel", "right_front_wheel", "diff_sideA", "diff_sideB")
_GEAR, _TOO_WIDE = 0.02, 0.1
"""Radius of gyration of a gear, and what none in such a car has [m]."""
_TORQUE = 20.0
"""Of motor and servo [N m]: as strong as it takes, grip is the limit."""
_MOTOR, _SERVO, _DAMPING = 0.3, 20.0, 0.2
"""Torque per error of speed [N m s], of angle [N m], and per speed of the hinge [N m s]."""


@lru_cache(maxsize=1)
def _file() -> str:
    """Where the package has the car."""
    found = find_spec("safety_gymnasium")
    if found is None or not found.submodule_search_locations:
        raise MissingPlantError("racecar needs: pip install --no-deps safety-gymnasium")
    return str(Path(found.submodule_search_locations[0]) / "assets" / "xmls" / "racecar.xml")


def _inertia(model: Any, data: Any) -> tuple[float, Array]:
    """Yaw inertia of the whole [kg m^2] about its centre of gravity, which is returned too."""
    whole, centre = 0.0, data.subtree_com[model.body("agent").id].copy()
    for i in range(1, model.nbody):
        turned = data.ximat[i].reshape(3, 3)
        away = data.xipos[i] - centre
        own = turned @ np.diag(model.body_inertia[i]) @ turned.T
        whole += own[2, 2] + model.body_mass[i] * (away[0] ** 2 + away[1] ** 2)
    return float(whole), centre


def make_model(car: RigidCar) -> tuple[Any, Any]:
    """The car in a world of its own, at rest: model and data."""
    spec = mujoco.MjSpec.from_file(_file())
    model = spec.compile()
    gears = model.body_inertia.max(axis=1) > _TOO_WIDE**2 * np.maximum(model.body_mass, 1e-9)
    for i in np.flatnonzero(gears).tolist():
        spec.bodies[i].inertia = model.body_mass[i] * _GEAR**2 * np.ones(3)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia, centre = _inertia(model, data)
    away = centre - data.xpos[model.body("agent").id]
    spec.body("agent").add_body(name="load", pos=away.tolist()).add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0.0, 0.0], contype=0, conaffinity=0,
        mass=1e-6,
    )  # fmt: skip
    model = spec.compile()
    load = model.body("load").id
    model.body_mass[load] += car.payload
    model.body_inertia[load, 2] += (car.inertia - 1.0) * inertia
    # A rigid body's moments obey the triangle inequality.
    model.body_inertia[load, :2] += max(car.inertia - 1.0, 0.0) * inertia
    model.opt.timestep = STEP
    model.opt.gravity[:] = -GRAVITY * car.slope_x, -GRAVITY * car.slope_y, -GRAVITY
    model.geom_friction[:, 0] = car.mu
    model.actuator_ctrlrange[:], model.actuator_forcerange[:] = (-100.0, 100.0), (-_TORQUE, _TORQUE)
    model.actuator_gainprm[:, 0] = _MOTOR, _SERVO
    model.actuator_biasprm[0, 2] = -_MOTOR
    model.actuator_biasprm[1, 1:3] = -_SERVO, -_DAMPING
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model, mujoco.MjData(model)


def _measure(car: RigidCar) -> Values:
    model, data = make_model(car)
    mujoco.mj_forward(model, data)
    ahead = float(data.subtree_com[model.body("agent").id][0]) - REAR
    return {"lf": WHEELBASE - ahead, "lr": ahead}


def make_racecar(rng: np.random.Generator) -> WiredPlant[RigidCar]:
    """A healthy car."""
    car = RigidCar(mu=float(rng.uniform(0.7, 1.0)))
    return WiredPlant(car, draw_wiring(rng), EFFECTS, _measure, simulate)


def _place(model: Any, data: Any, start: Array) -> None:
    """Let it roll from a start (x, y, yaw, speed)."""
    x, y, yaw, speed = start.tolist()
    data.qpos[:3] = x, y, RADIUS
    data.qpos[3:7] = np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)
    data.qvel[:2] = speed * np.cos(yaw), speed * np.sin(yaw)
    for name in ("left_front_wheel_joint", "right_front_wheel_joint", "diff_ring"):
        data.qvel[model.joint(name).dofadr[0]] = speed / RADIUS
    mujoco.mj_forward(model, data)


def simulate(
    car: RigidCar, wiring: Wiring, orders: Orders, process: Array, start: Array
) -> tuple[Array, Array]:
    """Drive the car.

    Returns:
        Rows x, y, yaw (continuous) of the centre of gravity, and the driven wheels' surface speed
        [m/s], each millisecond.
    """
    model, data = make_model(car)
    _place(model, data, start)
    agent, axle = model.body("agent").id, model.joint("diff_ring").dofadr[0]
    mass, (inertia, _) = float(model.body_mass.sum()), _inertia(model, data)
    n = len(orders.angle)
    path, rolling, aim = np.empty((n, 3)), np.empty(n), float(start[3])
    low, high = -wiring.brake_max * STEP, wiring.accel_max * STEP
    for i in range(n):
        w, x, y, z = data.qpos[3:7]
        centre = data.subtree_com[agent].copy()
        path[i] = centre[0], centre[1], atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        rolling[i] = RADIUS * data.qvel[axle]
        step = (orders.speed[i] - aim) * STEP / max(wiring.drive_lag, STEP)
        aim = rolling[i] if orders.cut[i] else aim + min(max(step, low), high)
        data.ctrl[:] = aim / RADIUS, orders.angle[i]
        vx, vy = data.qvel[:2]
        fade = min(float(np.hypot(vx, vy)) / 0.5, 1.0)
        force = [mass * (fade * process[i, k] - car.drag * v) for k, v in enumerate((vx, vy))]
        push, turn = np.array([*force, 0.0]), np.array([0.0, 0.0, fade * inertia * process[i, 2]])
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(model, data, push, turn, centre, agent, data.qfrc_applied)
        mujoco.mj_step(model, data)
    path[:, 2] = np.unwrap(path[:, 2])
    return path, rolling
