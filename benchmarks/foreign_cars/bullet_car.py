"""The racecar that comes with PyBullet: rigid wheels on a plane, with Coulomb friction.

The car and its physics are other people's (`pybullet_data/racecar/racecar.urdf`); here its joints
are driven, its numbers drawn, and things are made wrong with it. Its wheels barely slip before they
slide: there is no cornering stiffness to find.
"""

from math import atan, tan
from typing import Any

import numpy as np
import pybullet
import pybullet_data
from pybullet_utils.bullet_client import BulletClient

from benchmarks.blind_gap.effects import Values
from benchmarks.blind_gap.plant import STEP
from benchmarks.foreign_cars.plants import WiredPlant
from benchmarks.foreign_cars.rigid_car import EFFECTS, RigidCar
from benchmarks.foreign_cars.wiring import Array, Orders, Wiring, draw_wiring

GRAVITY = 9.81
RADIUS, TRACK, WHEELBASE = 0.05, 0.2, 0.325
"""Of the URDF [m]."""
_REAR = ("left_rear_wheel_joint", "right_rear_wheel_joint")
_FRONT = ("left_front_wheel_joint", "right_front_wheel_joint")
_HINGES = ("left_steering_hinge_joint", "right_steering_hinge_joint")
_FORCE = 20.0
"""Of motor and servos [N m]: as strong as it takes: grip is the limit."""


def _measure(car: RigidCar) -> Values:
    model = Model(car)
    try:
        return {"lf": WHEELBASE - model.ahead, "lr": model.ahead}
    finally:
        model.client.disconnect()


def make_bullet(rng: np.random.Generator) -> WiredPlant[RigidCar]:
    """A healthy car of plant d: PyBullet's racecar."""
    car = RigidCar(mu=float(rng.uniform(0.7, 1.0)))
    return WiredPlant(car, draw_wiring(rng), EFFECTS, _measure, simulate)


class Model:
    """The car in a world of its own.

    Attributes:
        client: the world; disconnect it.
        body: the car; `joints` its joints by name; `chassis` the link that has its mass.
        ahead: of the rear axle, the centre of gravity [m]; `beyond` of it, the chassis' own [m].
        mass: of the whole [kg]; `inertia` of the chassis about the vertical [kg m^2].
    """

    def __init__(self, car: RigidCar) -> None:
        self.client = world = BulletClient(pybullet.DIRECT)
        world.setAdditionalSearchPath(pybullet_data.getDataPath())
        world.setGravity(-GRAVITY * car.slope_x, -GRAVITY * car.slope_y, -GRAVITY)
        world.setTimeStep(STEP)
        floor = world.loadURDF("plane.urdf")
        self.body = world.loadURDF("racecar/racecar.urdf")
        count = range(world.getNumJoints(self.body))
        infos = [world.getJointInfo(self.body, i) for i in count]
        self.joints = {info[1].decode(): i for i, info in enumerate(infos)}
        self.chassis = next(i for i in count if infos[i][12] == b"chassis_inertia")
        world.changeDynamics(floor, -1, lateralFriction=1.0)
        for i in (-1, *count):  # the floor's friction times the tyre's
            world.changeDynamics(
                self.body, i, lateralFriction=car.mu, rollingFriction=0.0, spinningFriction=0.0,
                linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
            )  # fmt: skip
        mass, _, inertia, *_ = world.getDynamicsInfo(self.body, self.chassis)
        inertia = (*inertia[:2], inertia[2] * car.inertia)
        world.changeDynamics(
            self.body, self.chassis, mass=mass + car.payload, localInertiaDiagonal=inertia
        )
        self.inertia = inertia[2]
        masses = np.array([world.getDynamicsInfo(self.body, i)[0] for i in (-1, *count)])
        links = [world.getLinkState(self.body, i)[0][0] for i in count]
        places = np.array([world.getBasePositionAndOrientation(self.body)[0][0], *links])
        rear = float(np.mean([links[self.joints[name]] for name in _REAR]))
        self.mass = float(masses.sum())
        centre = float(masses @ places / self.mass)
        self.ahead, self.beyond = centre - rear, links[self.chassis] - centre

    def place(self, start: Array) -> None:
        """Let it roll from a start (x, y, yaw, speed)."""
        x, y, yaw, speed = start.tolist()
        world, body = self.client, self.body
        world.resetBasePositionAndOrientation(
            body, [x, y, 0.0], pybullet.getQuaternionFromEuler([0.0, 0.0, yaw])
        )
        world.resetBaseVelocity(body, [speed * np.cos(yaw), speed * np.sin(yaw), 0.0])
        for name in (*_REAR, *_FRONT):
            world.resetJointState(body, self.joints[name], 0.0, speed / RADIUS)
        for name in _FRONT:
            world.setJointMotorControl2(
                body, self.joints[name], pybullet.VELOCITY_CONTROL, force=0.0
            )

    def command(self, angle: float, rolling: float, turning: float, cut: bool) -> None:
        """Turn the front wheels, each by its place, and the rear ones through a differential."""
        world, body, joints = self.client, self.body, self.joints
        bend = 0.5 * TRACK * tan(angle) / WHEELBASE
        for name, inner in zip(_HINGES, (1.0 - bend, 1.0 + bend), strict=True):
            world.setJointMotorControl2(
                body, joints[name], pybullet.POSITION_CONTROL,
                targetPosition=atan(tan(angle) / inner), force=_FORCE, positionGain=0.5,
            )  # fmt: skip
        for name, side in zip(_REAR, (-1.0, 1.0), strict=True):
            world.setJointMotorControl2(
                body, joints[name], pybullet.VELOCITY_CONTROL,
                targetVelocity=(rolling + side * 0.5 * TRACK * turning) / RADIUS,
                force=0.0 if cut else _FORCE,
            )  # fmt: skip


def simulate(
    car: RigidCar, wiring: Wiring, orders: Orders, process: Array, start: Array
) -> tuple[Array, Array]:
    """Drive the car.

    Returns:
        Rows x, y, yaw (continuous) of the centre of gravity, and the driven wheels' surface speed
        [m/s], each millisecond.
    """
    model = Model(car)
    try:
        return _simulate(model, car, wiring, orders, process, start)
    finally:
        model.client.disconnect()


def _simulate(
    model: Model, car: RigidCar, wiring: Wiring, orders: Orders, process: Array, start: Array
) -> tuple[Array, Array]:
    world: Any = model.client
    body, n = model.body, len(orders.angle)
    model.place(start)
    path, rolling, aim = np.empty((n, 3)), np.empty(n), float(start[3])
    rear = [model.joints[name] for name in _REAR]
    low, high = -wiring.brake_max * STEP, wiring.accel_max * STEP
    for i in range(n):
        state = world.getLinkState(body, model.chassis, computeLinkVelocity=1)
        (x, y, z), turned, (vx, vy, _), (_, _, turning) = state[0], state[1], state[6], state[7]
        yaw = pybullet.getEulerFromQuaternion(turned)[2]
        path[i] = x - model.beyond * np.cos(yaw), y - model.beyond * np.sin(yaw), yaw
        spins = [state[1] for state in world.getJointStates(body, rear)]
        rolling[i] = RADIUS * 0.5 * (spins[0] + spins[1])
        step = (orders.speed[i] - aim) * STEP / max(wiring.drive_lag, STEP)
        aim = rolling[i] if orders.cut[i] else aim + min(max(step, low), high)
        model.command(float(orders.angle[i]), aim, turning, orders.cut[i] > 0.0)
        fade = min(float(np.hypot(vx, vy)) / 0.5, 1.0)
        force = [model.mass * (fade * process[i, k] - car.drag * v) for k, v in enumerate((vx, vy))]
        world.applyExternalForce(
            body, model.chassis, [*force, 0.0], [x, y, z], pybullet.WORLD_FRAME
        )
        torque = [0.0, 0.0, fade * model.inertia * float(process[i, 2])]
        world.applyExternalTorque(body, model.chassis, torque, pybullet.WORLD_FRAME)
        world.stepSimulation()
    path[:, 2] = np.unwrap(path[:, 2])
    return path, rolling
