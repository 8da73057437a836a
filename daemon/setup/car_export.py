"""A car file for other simulators: f1tenth_gym's parameters, and a MuJoCo model.

Both hold less than a car file does. What is left out is said in the text itself and to the caller,
so that nobody takes the export for the car. Sources: f1tenth_gym's default parameters (names and
signs are CommonRoad's), MuJoCo's XML reference.
"""

from collections.abc import Mapping
from math import inf, sqrt
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from steerd.car_model.car_file import CarFile
from steerd.car_model.params import GRAVITY, Car, wheelbase

_GYM_WIDTH, _GYM_LENGTH = 0.31 / 0.3302, 0.58 / 0.3302  # outline of f1tenth_gym's car per wheelbase
_RADIUS, _TRACK = 0.15, 0.76  # a wheel's radius and the track of an F1TENTH car per wheelbase
_WHEEL_MASS, _WHEEL_YAW = 0.02, 0.25
"""Most of the car's mass that one wheel may have, and of its yaw inertia that all four may."""
_ROLL, _PITCH = 0.35, 0.8
"""Inertia of the body about its long and its cross axis per yaw inertia: of a flat box."""
_STEP = 0.002  # MuJoCo's step [s]
_IMPEDANCE = 0.99
"""Of the contacts, MuJoCo's `solimp`, at every depth: near 1, where creep is easily said."""
_KNUCKLE, _KNUCKLE_INERTIA = 20.0, 1e-3
"""Stiffness [N m/rad] and inertia [kg m^2] of a steered wheel: 141 rad/s, ten times a servo."""


class Export(NamedTuple):
    """A car for another simulator, and what of the car is not in it, a sentence each."""

    text: str
    lost: tuple[str, ...]


def _find_lost(file: CarFile, neutral: Mapping[str, float]) -> list[str]:
    """Parameters with another value than the neutral one, effects and chassis, as sentences."""
    car = file.car
    away = [
        f"{name} = {getattr(car, name):g}"
        for name, null in neutral.items()
        if getattr(car, name) != null
    ]
    lost = [f"not in this model: {', '.join(away)}"] if away else []
    names = ", ".join(effect.name for effect in file.effects)
    return lost + ([f"effects of the car file that are left out: {names}"] if names else [])


_DELAYS = {"steer_delay": 0.0, "drive_delay": 0.0, "pose_delay": 0.0}


def make_gym_yaml(file: CarFile, speed_max: float) -> Export:
    """The `params` of f1tenth_gym's single-track car, which drives at most `speed_max` [m/s]."""
    car = file.car
    neutral = {**_DELAYS, "steer_gain": 1.0, "steer_bias": 0.0, "steer_lag": 0.0}
    neutral |= {"speed_gain": 1.0, "speed_lag": 0.0, "decel_max": car.accel_max}
    lost = _find_lost(file, neutral)
    if file.chassis.drive:
        lost.append(f"the {file.chassis.label} equations: the gym's car is single-track")
    lost.append("width and length are the gym's own, by wheelbase: a car file has none")
    base = wheelbase(car)
    values = {
        "mu": car.mu, "C_Sf": car.c_sf, "C_Sr": car.c_sr, "lf": car.lf, "lr": car.lr,
        "h": car.cog_height, "m": car.mass, "I": car.inertia_z,
        "s_min": car.steer_min, "s_max": car.steer_max,
        "sv_min": -car.steer_rate, "sv_max": car.steer_rate,
        # The motor's limit falls with speed above v_switch; the car file's is the same at all.
        "v_switch": speed_max, "a_max": car.accel_max, "v_min": 0.0, "v_max": speed_max,
        "width": _GYM_WIDTH * base, "length": _GYM_LENGTH * base,
    }  # fmt: skip
    lines = [f"# {line}" for line in _head(file, lost)]
    lines += [f"{name}: {float(f'{value:.6g}')!r}" for name, value in values.items()]
    return Export("\n".join(lines) + "\n", tuple(lost))


def _head(file: CarFile, lost: list[str]) -> list[str]:
    return [f"{' '.join(file.name.split())}, written by steerd export. What is lost:", *lost]


# -- MuJoCo ----------------------------------------------------------------------------------------


class _Wheel(NamedTuple):
    name: str
    x: float
    y: float
    coefficient: float  # cornering force per load, friction and slip angle [1/rad]


def make_mjcf(file: CarFile, speed: float) -> Export:
    """A MuJoCo model: a body on four wheels, two of them steered, without suspension.

    `steer_left` and `steer_right` take the steering command [rad], `drive` the speed [m/s], with
    the car's gains and lags. MuJoCo's tyres creep with a slip speed, not with a slip angle: in a
    steady turn the car's and MuJoCo's are equal at this speed [m/s].
    """
    car = file.car
    lost = _find_lost(file, {**_DELAYS, "steer_rate": inf})
    lost += [
        f"tyres slip as the car's at {speed:g} m/s, at half that speed twice as far",
        "c_x has no counterpart; friction limits the tyres, which the car's equations do not",
        "wheels, track, outline, and the inertia of roll and pitch are guesses by wheelbase",
    ]
    half = 0.5 * _TRACK * wheelbase(car)
    wheels = [
        _Wheel(f"{axle}_{side}", x, y, coefficient)
        for axle, x, coefficient in (("front", car.lf, car.c_sf), ("rear", -car.lr, car.c_sr))
        for side, y in (("left", half), ("right", -half))
    ]
    drive = file.chassis.drive or "all"
    driven = [w for w in wheels if drive == "all" or w.name.startswith(drive)]
    radius = _RADIUS * wheelbase(car)
    share = radius / len(driven)
    parts = {
        "name": quoteattr(file.name),
        "about": "\n     ".join(_head(file, lost)).replace("--", "-"),
        "body": _body(car, wheels),
        "contacts": "\n    ".join(_contact(car, wheel, speed) for wheel in wheels),
        "driven": "".join(f'<joint joint="spin_{w.name}" coef="{share:.6g}"/>' for w in driven),
        "actuators": "\n    ".join((_servo(car, "left"), _servo(car, "right"), _motor(car))),
    }
    return Export(_MJCF.format(step=_STEP, gravity=GRAVITY, **parts), tuple(lost))


_MJCF = """<mujoco model={name}>
<!-- {about} -->
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{step}" integrator="implicitfast" cone="elliptic" gravity="0 0 -{gravity}"/>
  <worldbody>
    <light pos="0 0 5" directional="true"/>
    <geom name="floor" type="plane" size="50 50 1" contype="0" conaffinity="0"/>
    {body}
  </worldbody>
  <contact>
    {contacts}
  </contact>
  <tendon><fixed name="driven">{driven}</fixed></tendon>
  <actuator>
    {actuators}
  </actuator>
</mujoco>
"""


def _body(car: Car[float], wheels: list[_Wheel]) -> str:
    """Body and wheels, whose common centre of gravity is the origin of the body's frame."""
    turning, radius = sum(w.x**2 + w.y**2 for w in wheels), _RADIUS * wheelbase(car)
    mass = min(_WHEEL_MASS * car.mass, _WHEEL_YAW * car.inertia_z / turning)
    body = car.mass - 4.0 * mass
    x = -mass * sum(w.x for w in wheels) / body
    z = 4.0 * mass * (car.cog_height - radius) / body
    across, spin = 0.3 * mass * radius**2, 0.5 * mass * radius**2
    yaw = car.inertia_z - body * x**2 - mass * turning - 4.0 * across
    inertia = f"{_ROLL * yaw:.6g} {_PITCH * yaw:.6g} {yaw:.6g}"
    outline = f"{0.6 * wheelbase(car):.6g} {0.3 * wheelbase(car):.6g} {0.2 * wheelbase(car):.6g}"
    joint = (
        f'<joint name="steer_{{side}}" axis="0 0 1" armature="{_KNUCKLE_INERTIA}" '
        f'range="{car.steer_min:.6g} {car.steer_max:.6g}"/>'
    )
    lines = [
        f'<body name="car" pos="0 0 {car.cog_height:.6g}">',
        "  <freejoint/>",
        f'  <inertial pos="{x:.6g} 0 {z:.6g}" mass="{body:.6g}" diaginertia="{inertia}"/>',
        f'  <geom type="box" size="{outline}" contype="0" conaffinity="0" rgba=".3 .5 .8 .5"/>',
    ]
    for w in wheels:
        lines += [
            f'  <body name="{w.name}" pos="{w.x:.6g} {w.y:.6g} {radius - car.cog_height:.6g}">',
            *([f"    {joint.format(side=w.name.removeprefix('front_'))}"] if w.x > 0.0 else []),
            f'    <joint name="spin_{w.name}" axis="0 1 0"/>',
            f'    <inertial pos="0 0 0" mass="{mass:.6g}" '
            f'diaginertia="{across:.6g} {spin:.6g} {across:.6g}"/>',
            f'    <geom name="tyre_{w.name}" type="ellipsoid" '
            f'size="{radius:.6g} {0.4 * radius:.6g} {radius:.6g}" contype="0" conaffinity="0"/>',
            "  </body>",
        ]
    return "\n    ".join([*lines, "</body>"])


def _contact(car: Car[float], wheel: _Wheel, speed: float) -> str:
    """The tyre: in a steady turn a wheel that carries m with slip angle a feels mu c g m a.

    MuJoCo brakes the slip speed s at `2 / (impedance * time constant) * s`, which there is the
    lateral acceleration; s is a times the speed.
    """
    creep = 2.0 * speed / (_IMPEDANCE * car.mu * wheel.coefficient * GRAVITY)
    return (
        f'<pair geom1="floor" geom2="tyre_{wheel.name}" condim="3" '
        f'friction="{car.mu:.6g} {car.mu:.6g} 0.005 0.0001 0.0001" solref="0.01 1" '
        f'solreffriction="{creep:.6g} 1" solimp="{_IMPEDANCE} {_IMPEDANCE} 0.001"/>'
    )


def _servo(car: Car[float], side: str) -> str:
    """A steering servo: the command through gain, bias and lag."""
    ends = sorted((end - car.steer_bias) / car.steer_gain for end in (car.steer_min, car.steer_max))
    damping = 2.0 * sqrt(_KNUCKLE * _KNUCKLE_INERTIA)
    return (
        f'<general name="steer_{side}" joint="steer_{side}" dyntype="filterexact" '
        f'dynprm="{max(car.steer_lag, _STEP):.6g}" ctrlrange="{ends[0]:.6g} {ends[1]:.6g}" '
        f'gainprm="{_KNUCKLE * car.steer_gain:.6g}" biastype="affine" '
        f'biasprm="{_KNUCKLE * car.steer_bias:.6g} -{_KNUCKLE} -{damping:.6g}"/>'
    )


def _motor(car: Car[float]) -> str:
    """The speed loop: a first-order lag within the limits of acceleration."""
    stiff = car.mass / max(car.speed_lag, 5.0 * _STEP)
    return (
        f'<general name="drive" tendon="driven" gainprm="{stiff * car.speed_gain:.6g}" '
        f'biastype="affine" biasprm="0 0 -{stiff:.6g}" '
        f'forcerange="-{car.mass * car.decel_max:.6g} {car.mass * car.accel_max:.6g}"/>'
    )
