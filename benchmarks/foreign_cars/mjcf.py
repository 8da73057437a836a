"""A 1:10 car for MuJoCo: its numbers, and the model that they make.

Chassis on a free joint, four vertical slides with springs and dampers, two steered knuckles with a
position-actuated servo each, four hinged wheels, driven through open differentials by a velocity
loop. The origin of the chassis frame is at the car's centre of gravity.
"""

from math import pi
from typing import Any, NamedTuple

import mujoco
import numpy as np

from benchmarks.blind_gap.car import GRAVITY
from benchmarks.blind_gap.plant import STEP
from benchmarks.foreign_cars.tyre import Tyre

WHEELS = ("fl", "fr", "rl", "rr")
_WIDTH = 0.022
"""Half width of the ellipsoid that stands for a wheel [m]."""
_SPREAD = 0.10


class MujocoCar(NamedTuple):
    """Numbers of the car, SI units."""

    contact: bool
    """Whether MuJoCo's own contacts are the tyres; else `tyre`'s forces act on the wheels."""
    tyre: Tyre
    creep_front: float
    """Time constant of the contacts' friction: the larger, the softer [s]."""
    creep_rear: float
    all_driven: bool
    mass: float = 3.5
    payload: float = 0.0
    """Weight added at the centre of gravity; the springs give way to it [kg]."""
    inertia_z: float = 0.047
    """Of the whole car [kg m^2]."""
    lf: float = 0.159
    lr: float = 0.171
    track: float = 0.25
    height: float = 0.06
    """Of the centre of gravity [m]."""
    radius: float = 0.053
    corner_mass: float = 0.10
    """Of a wheel; its hub is a fifth of it more [kg]."""
    ride_hz: float = 3.5
    ride_damping: float = 0.5
    ackermann: float = 0.6
    """Share of the geometric difference between the front wheels' angles."""
    knuckle: float = 4.0
    """Stiffness of a steering knuckle [N m/rad]."""
    loose: float = 0.0
    """Play of the front right knuckle alone [rad]."""
    wobble: float = 0.0
    """Amplitude of a wobble of the front left wheel per speed, once a turn [rad s/m]."""
    left: float = 0.0
    """Relative grip that the left tyres have less, and the right ones more."""
    differential: float = 0.3
    """Yaw damping by the grease of the differentials [1/s]."""
    drag: float = 0.15
    """Rolling resistance [m/s^2]."""
    corner_brake: float = 0.0
    """Drag of the front right wheel, per weight of the car."""
    slope_x: float = 0.0
    slope_y: float = 0.0
    grip_rate: float = 0.0
    """Growth of grip per minute [1/min]."""
    patch_x: float = 0.0
    patch_y: float = 0.0
    patch_radius: float = 0.5
    patch_drop: float = 0.0


def draw_car(contact: bool, rng: np.random.Generator) -> MujocoCar:
    """A healthy car: rear or all wheels driven, everything that differs within 10 %."""

    def about(value: float) -> float:
        return value * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD))

    tyre = Tyre(
        about(1.0), about(5.2), about(5.6), about(14.0), about(1.35), about(0.12), about(0.035),
        about(0.006),
    )  # fmt: skip
    base = MujocoCar(contact, tyre, about(0.012), about(0.010), bool(rng.random() < 0.5))
    names = ("mass", "inertia_z", "lf", "lr", "track", "height", "ride_hz", "drag")
    drawn = base._replace(**{name: about(getattr(base, name)) for name in names})
    return drawn._replace(ackermann=float(rng.uniform(0.2, 1.0)))


def hub_mass(car: MujocoCar) -> float:
    """Mass of a hub [kg]."""
    return 0.2 * car.corner_mass


def wheel_inertia(car: MujocoCar) -> float:
    """Of one wheel about its axle, its share of the motor included [kg m^2]."""
    return 0.8 * car.corner_mass * car.radius**2


def rolling_mass(car: MujocoCar) -> float:
    """What the motor accelerates: the car and the inertia of its wheels [kg]."""
    return car.mass + car.payload + 4.0 * wheel_inertia(car) / car.radius**2


def rest_loads(car: MujocoCar) -> np.ndarray:
    """Wheel loads at rest without payload [N]."""
    half = 0.5 * car.mass * GRAVITY / (car.lf + car.lr)
    return np.array([half * car.lr, half * car.lr, half * car.lf, half * car.lf])


def _corner(car: MujocoCar, wheel: int) -> str:
    """One slide, knuckle and wheel."""
    name, front = WHEELS[wheel], wheel < 2
    x = car.lf if front else -car.lr
    y = 0.5 * car.track * (1 if wheel % 2 == 0 else -1)
    hub, m = hub_mass(car), car.corner_mass
    sprung = rest_loads(car)[wheel] / GRAVITY - hub - m
    spring = sprung * (2.0 * pi * car.ride_hz) ** 2
    damper = 2.0 * car.ride_damping * sprung * 2.0 * pi * car.ride_hz
    rest = -sprung * GRAVITY / spring
    spin, across = wheel_inertia(car), 0.5 * m * car.radius**2
    friction = 0.25 * rolling_mass(car) * car.drag * car.radius
    if wheel == 1:
        friction += car.corner_brake * car.mass * GRAVITY * car.radius
    steer = (
        f'<joint name="steer_{name}" type="hinge" axis="0 0 1" damping="0.04" armature="2e-5"/>'
        if front
        else ""
    )
    return f"""
    <body name="hub_{name}" pos="{x} {y} {car.radius - car.height}">
      <inertial pos="0 0 0" mass="{hub}" diaginertia="1e-5 1e-5 1e-5"/>
      <joint name="ride_{name}" type="slide" axis="0 0 1" stiffness="{spring}" damping="{damper}"
             springref="{rest}"/>
      {steer}
      <site name="hub_{name}"/>
      <body name="wheel_{name}">
        <inertial pos="0 0 0" mass="{m}" diaginertia="{across} {spin} {across}"/>
        <joint name="spin_{name}" type="hinge" axis="0 1 0" frictionloss="{friction}"/>
        <geom name="tyre_{name}" type="ellipsoid" size="{car.radius} {_WIDTH} {car.radius}"/>
        <site name="patch_{name}" type="sphere" size="{1.2 * car.radius}"/>
      </body>
    </body>"""


def _tyres(car: MujocoCar) -> str:
    """Contacts of the wheels with the floor: tyres by themselves, or mere carriers of load."""
    lines = []
    for wheel, name in enumerate(WHEELS):
        creep = car.creep_front if wheel < 2 else car.creep_rear
        mu = car.tyre.mu if car.contact else 0.0
        shape = f'condim="6" friction="{mu} {mu} 0.002 0.0001 0.0001"' if car.contact else ""
        soft = f'solreffriction="{creep} 1"' if car.contact else ""
        shape = shape or 'condim="1"'
        lines.append(
            f'<pair geom1="floor" geom2="tyre_{name}" {shape} solref="0.01 1" {soft}'
            ' solimp="0.9 0.95 0.001"/>'
        )
    return "\n    ".join(lines)


def _drive(car: MujocoCar, lag: float, accel: float) -> str:
    """Differentials and the motor's velocity loop, between forward and brake limits."""
    driven = WHEELS if car.all_driven else WHEELS[2:]
    joints = "".join(f'<joint joint="spin_{n}" coef="{1.0 / len(driven)}"/>' for n in driven)
    axles = ("fl", "fr"), ("rl", "rr")
    shared = axles if car.all_driven else axles[1:]
    rub = car.differential * car.inertia_z * (car.radius / car.track) ** 2 / len(shared)
    grease = "".join(
        f'<fixed name="grease_{a}" damping="{rub}"><joint joint="spin_{a}" coef="1"/>'
        f'<joint joint="spin_{b}" coef="-1"/></fixed>'
        for a, b in shared
    )
    # Limits and gain are those of the motor: a payload makes both slower.
    moved = rolling_mass(car._replace(payload=0.0))
    gain = moved * car.radius**2 / max(lag, 2.0 * STEP)
    most = moved * accel * car.radius
    return f"""
  <tendon><fixed name="motor">{joints}</fixed>{grease}</tendon>
  <actuator>
    <velocity name="motor" tendon="motor" kv="{gain}" forcerange="-{most} {most}"/>
    <position name="servo_fl" joint="steer_fl" kp="{car.knuckle}"/>
    <position name="servo_fr" joint="steer_fr" kp="{car.knuckle}"/>
  </actuator>"""


def make_xml(car: MujocoCar, lag: float, accel: float) -> str:
    """The car as MJCF.

    Args:
        car: its numbers.
        lag: time constant of the motor's velocity loop [s].
        accel: acceleration at which the motor's current is limited, both ways [m/s^2].
    """
    corner = hub_mass(car) + car.corner_mass
    body = car.mass + car.payload - 4.0 * corner
    back = -2.0 * corner * (car.lf - car.lr) / body
    up = 4.0 * corner * (car.height - car.radius) / body
    corners = "".join(_corner(car, wheel) for wheel in range(4))
    sensors = "".join(f'<velocimeter site="hub_{n}"/>' for n in WHEELS)
    sensors += "".join(f'<touch site="patch_{n}"/>' for n in WHEELS)
    gravity = f"{GRAVITY * car.slope_x} {GRAVITY * car.slope_y} -{GRAVITY}"
    return f"""<mujoco model="foreign car">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="0.1"
          gravity="{gravity}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="0" conaffinity="0"/>
    <body name="chassis" pos="0 0 {car.height}">
      <freejoint/>
      <inertial pos="{back} 0 {up}" mass="{body}" diaginertia="0.012 0.022 0.03"/>
      {corners}
    </body>
  </worldbody>
  <contact>
    {_tyres(car)}
  </contact>{_drive(car, lag, accel)}
  <sensor>{sensors}</sensor>
</mujoco>"""


def make_model(car: MujocoCar, lag: float, accel: float) -> Any:
    """The compiled model, the chassis' yaw inertia set so that the whole car has `inertia_z`."""
    model = mujoco.MjModel.from_xml_string(make_xml(car, lag, accel))
    model.body_inertia[model.body("chassis").id][2] += car.inertia_z - yaw_inertia(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def yaw_inertia(model: Any) -> float:
    """Of a model about the vertical through its centre of gravity, wheels straight [kg m^2]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    mass = float(model.body_mass.sum())
    centre = data.subtree_com[model.body("chassis").id] - data.qpos[:3]
    return float(whole[5, 5] - mass * (centre[0] ** 2 + centre[1] ** 2))
