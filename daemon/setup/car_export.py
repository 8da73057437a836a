"""A car file for other simulators: f1tenth_gym's parameters, and a MuJoCo model.

Both hold less than a car file does. What is left out is said in the text itself and to the caller,
so that nobody takes the export for the car. Sources: f1tenth_gym's default parameters (names and
signs are CommonRoad's), MuJoCo's XML reference.
"""

from collections.abc import Mapping
from math import inf, sqrt
from pathlib import Path
from typing import Any, NamedTuple

from steerd.car_model.car_file import CarFile
from steerd.car_model.params import GRAVITY, Car, wheelbase
from steerd.sysid.report.page import render_page

_MJCF = Path(__file__).parent / "templates" / "car.xml"
_GYM_WIDTH, _GYM_LENGTH = 0.31 / 0.3302, 0.58 / 0.3302  # outline of f1tenth_gym's car per wheelbase
_RADIUS, _TRACK = 0.15, 0.76  # a wheel's radius and the track of an F1TENTH car per wheelbase
_WHEEL_MASS, _WHEEL_YAW = 0.02, 0.25
"""Most of the car's mass that one wheel may have, and of its yaw inertia that all four may."""
_ROLL, _PITCH = 0.35, 0.8  # inertia about long and cross axis per yaw inertia: of a flat box
_STEP = 0.002  # MuJoCo's step [s]
_IMPEDANCE = 0.99  # MuJoCo's `solimp` at every depth: near 1, where creep is easily said
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


_HEAD = "{}, written by steerd export. What is lost:"
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
    lines = [f"# {line}" for line in (_HEAD.format(" ".join(file.name.split())), *lost)]
    lines += [f"{name}: {float(f'{value:.6g}')!r}" for name, value in values.items()]
    return Export("\n".join(lines) + "\n", tuple(lost))


# -- MuJoCo ----------------------------------------------------------------------------------------


class _Wheel(NamedTuple):
    """A tyre; in a steady turn a wheel that carries m with slip angle a feels mu c g m a.

    MuJoCo brakes the slip speed s at `2 / (impedance * time constant) * s`, which there is the
    lateral acceleration; s is a times the speed.
    """

    name: str
    x: float
    y: float
    creep: float  # MuJoCo's `solreffriction` of the tyre, its time constant [s]


def make_mjcf(file: CarFile, speed: float) -> Export:
    """A MuJoCo model: a body on four wheels, two of them steered, without suspension.

    `steer_left` and `steer_right` take the steering command [rad], `drive` the speed [m/s], with
    the car's gains and lags. MuJoCo's tyres creep with a slip speed, not with a slip angle: in a
    steady turn the car's and MuJoCo's are equal at this speed [m/s].
    """
    car, base = file.car, wheelbase(file.car)
    lost = _find_lost(file, {**_DELAYS, "steer_rate": inf})
    lost += [
        f"tyres slip as the car's at {speed:g} m/s, at half that speed twice as far",
        "c_x has no counterpart; friction limits the tyres, which the car's equations do not",
        "wheels, track, outline, and the inertia of roll and pitch are guesses by wheelbase",
    ]
    half = 0.5 * _TRACK * base
    wheels = [
        _Wheel(f"{axle}_{side}", x, y, 2.0 * speed / (_IMPEDANCE * car.mu * cornering * GRAVITY))
        for axle, x, cornering in (("front", car.lf, car.c_sf), ("rear", -car.lr, car.c_sr))
        for side, y in (("left", half), ("right", -half))
    ]
    drive = file.chassis.drive or "all"
    values = {
        "name": file.name,
        "about": "\n     ".join((_HEAD.format(" ".join(file.name.split())), *lost))
                 .replace("--", "-"),
        "step": _STEP, "gravity": GRAVITY, "impedance": _IMPEDANCE, "knuckle": _KNUCKLE,
        "knuckle_inertia": _KNUCKLE_INERTIA, "car": car, "wheels": wheels,
        "driven": [w for w in wheels if drive == "all" or w.name.startswith(drive)],
        "outline": (0.6 * base, 0.3 * base, 0.2 * base),
        # The servo's ends are those of its command; the speed loop is a first-order lag.
        "ends": sorted((end - car.steer_bias) / car.steer_gain
                       for end in (car.steer_min, car.steer_max)),
        "lag": max(car.steer_lag, _STEP), "damping": 2.0 * sqrt(_KNUCKLE * _KNUCKLE_INERTIA),
        "stiff": car.mass / max(car.speed_lag, 5.0 * _STEP),
        "g": lambda *numbers: " ".join(f"{number:.6g}" for number in numbers),
    }  # fmt: skip
    return Export(render_page(_MJCF, **values, **_share_mass(car, wheels)) + "\n", tuple(lost))


def _share_mass(car: Car[float], wheels: list[_Wheel]) -> dict[str, Any]:
    """Body and wheels, whose common centre of gravity is the origin of the body's frame."""
    turning, radius = sum(w.x**2 + w.y**2 for w in wheels), _RADIUS * wheelbase(car)
    mass = min(_WHEEL_MASS * car.mass, _WHEEL_YAW * car.inertia_z / turning)
    body = car.mass - 4.0 * mass
    x = -mass * sum(w.x for w in wheels) / body
    z = 4.0 * mass * (car.cog_height - radius) / body
    across, spin = 0.3 * mass * radius**2, 0.5 * mass * radius**2
    yaw = car.inertia_z - body * x**2 - mass * turning - 4.0 * across
    return {
        "radius": radius, "mass": mass, "across": across, "spin": spin,
        "body": body, "x": x, "z": z, "inertia": (_ROLL * yaw, _PITCH * yaw, yaw),
    }  # fmt: skip
