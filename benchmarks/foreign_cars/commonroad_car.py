"""CommonRoad's multi-body car (a BMW 320i), made 1:10 by dimensional analysis, and driven.

Lengths are scaled so that the wheelbase is that of a 1:10 car, masses so that the car weighs
3.5 kg, and gravity stays: times and speeds then go with the root of the length, accelerations and
slip angles stay, tyre forces stay in proportion to loads. Its tyres remain those of the passenger
car: three to four times as stiff per load as rubber of a 1:10 car.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import cos, exp, hypot, sin, sqrt, tanh
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from benchmarks.blind_gap.car import GRAVITY
from benchmarks.blind_gap.drives import LEAD
from benchmarks.blind_gap.effects import Place, Values
from benchmarks.blind_gap.plant import STEP, TICK
from benchmarks.foreign_cars.commonroad_rhs import STATES, as_tuple, rhs
from benchmarks.foreign_cars.drives import Commands
from benchmarks.foreign_cars.effects import WIRED, WIRED_OUTSIDE
from benchmarks.foreign_cars.log import Log
from benchmarks.foreign_cars.wiring import Wiring, draw_wiring, make_orders, make_push, observe

Array = NDArray[np.float64]

WHEELBASE, MASS = 0.33, 3.5
_BMW = 2
PARTS = 2
"""Steps of the integrator per millisecond."""
_SPREAD = 0.10
_EDGE = 0.05
_SLOW = 0.5
_LENGTHS = ("l", "w", "a", "b", "T_f", "T_r", "h_cg", "h_raf", "h_rar", "h_s", "R_w")
_MASSES = ("m", "m_s", "m_uf", "m_ur")
_INERTIAS = ("I_Phi_s", "I_y_s", "I_z", "I_xz_s", "I_uf", "I_ur", "I_y_w")
_SPRINGS = ("K_sf", "K_sr", "K_ras", "K_zt")
_DAMPERS = ("K_sdf", "K_sdr", "K_rad")
_TORSIONS = ("K_tsf", "K_tsr")
_PER_LENGTH = ("D_f", "D_r")


class Floor(NamedTuple):
    """What the car drives on, and what rubs in it; SI units."""

    drag: float = 0.15
    """Rolling resistance [m/s^2]."""
    corner_brake: float = 0.0
    """Drag of the front right wheel alone, per weight of the car."""
    differential: float = 0.3
    """Yaw damping by coupling of the rear wheels [1/s]."""
    slope_x: float = 0.0
    slope_y: float = 0.0
    grip_rate: float = 0.0
    """Growth of grip per minute [1/min]."""
    patch_x: float = 0.0
    patch_y: float = 0.0
    patch_radius: float = 0.5
    patch_drop: float = 0.0
    wobble: float = 0.0
    """Amplitude of a wobble of the steering per speed, once a wheel turn [rad s/m]."""


@dataclass(frozen=True, slots=True)
class CommonRoadPlant:
    """Plant c.

    Attributes:
        car: parameters of the package, scaled (`Vehicle`).
        floor: friction, slope, drag.
        wiring: actuators and sensors.
        motor_mass: what the motor was laid out for [kg]; a payload makes it slower.
    """

    car: Any
    floor: Floor
    wiring: Wiring
    motor_mass: float

    @property
    def effects(self) -> frozenset[str]:
        """Effects that it can have: its four tyres are one, so no balance of theirs."""
        return frozenset(WIRED) | frozenset(_EFFECTS)

    @property
    def outside(self) -> frozenset[str]:
        """Defects outside the library that it can have."""
        return frozenset(WIRED_OUTSIDE) | frozenset(_OUTSIDE)

    @property
    def truth(self) -> Values:
        """Lengths [m], yaw inertia [kg m^2], cornering force per load and slip angle [1/rad]."""
        stiff = -self.car.tire.p_ky1
        return {
            "lf": self.car.a,
            "lr": self.car.b,
            "inertia_z": self.car.I_z + _wheels_inertia(self.car),
            "front": stiff,
            "rear": stiff,
        }

    def with_effect(self, name: str, values: Values) -> "CommonRoadPlant":
        """The car with an effect of the contract."""
        if name in WIRED:
            return replace(self, wiring=WIRED[name](self.wiring, values))
        return _EFFECTS[name](self, values)

    def with_outside(self, name: str, strength: float, place: Place) -> "CommonRoadPlant":
        """The car with a defect that no effect describes."""
        if name in WIRED_OUTSIDE:
            wiring = self.wiring._replace(**{WIRED_OUTSIDE[name]: strength})
            return replace(self, wiring=wiring)
        return replace(self, floor=self.floor._replace(**{_OUTSIDE[name]: strength}))

    def drive(self, commands: Commands, rng: np.random.Generator) -> Log:
        """Drive it and record."""
        orders = make_orders(self.wiring, commands, rng)
        push = make_push(commands, rng)
        states = simulate(self, orders, push.process, commands.start)
        return observe(
            self.wiring, commands, states[:, [0, 1, 4]], rolling(self.car, states), push.pose, rng
        )


def make_commonroad(rng: np.random.Generator) -> CommonRoadPlant:
    """A healthy car."""
    car = draw_car(rng)
    drag = float(rng.uniform(0.135, 0.165))
    return CommonRoadPlant(car, Floor(drag=drag), draw_wiring(rng), rolling_mass(car))


def _wheels_inertia(car: Any) -> float:
    """What spinning wheels add to the yaw inertia: left and right must turn apart [kg m^2]."""
    return float(car.I_y_w * (car.T_f**2 + car.T_r**2) / (2.0 * car.R_w**2))


def _tire(plant: CommonRoadPlant, names: tuple[str, ...], ratio: float) -> CommonRoadPlant:
    tire = plant.car.tire
    scaled = {name: ratio * getattr(tire, name) for name in names}
    return replace(plant, car=plant.car._replace(tire=tire._replace(**scaled)))


def _floor(plant: CommonRoadPlant, **values: float) -> CommonRoadPlant:
    return replace(plant, floor=plant.floor._replace(**values))


def _payload(plant: CommonRoadPlant, kg: float) -> CommonRoadPlant:
    """Weight at the sprung mass' centre; springs and tyres give way to it."""
    car = plant.car
    return replace(plant, car=car._replace(m=car.m + kg, m_s=car.m_s + kg))


def _shift_cog(plant: CommonRoadPlant, d: float) -> CommonRoadPlant:
    car, w = plant.car, plant.wiring
    return replace(
        plant,
        car=car._replace(a=car.a - d, b=car.b + d),
        wiring=w._replace(marker_x=w.marker_x - d),
    )


def _inertia(plant: CommonRoadPlant, ratio: float) -> CommonRoadPlant:
    """The whole yaw inertia scaled, wheels included: what a planar model can see."""
    car = plant.car
    whole = car.I_z + _wheels_inertia(car)
    return replace(plant, car=car._replace(I_z=car.I_z + (ratio - 1.0) * whole))


_GRIP = ("p_dx1", "p_dy1")
_EFFECTS: Mapping[str, Callable[[CommonRoadPlant, Values], CommonRoadPlant]] = {
    "rolling_drag": lambda p, v: _floor(p, drag=p.floor.drag + v["drag"]),
    "tyre_friction": lambda p, v: _tire(p, _GRIP, v["ratio"]),
    "cornering_stiffness": lambda p, v: _tire(p, ("p_ky1",), v["ratio"]),
    "grip_drift": lambda p, v: _floor(p, grip_rate=p.floor.grip_rate + v["rate"]),
    "grip_patch": lambda p, v: _floor(p, **{f"patch_{k}": value for k, value in v.items()}),
    "scrub": lambda p, v: _floor(p, differential=p.floor.differential + v["yaw_damping"]),
    "mass": lambda p, v: _payload(p, v["payload"]),
    "cog_offset": lambda p, v: _shift_cog(p, v["offset"]),
    "yaw_inertia": lambda p, v: _inertia(p, v["ratio"]),
    "floor_slope": lambda p, v: _floor(p, slope_x=v["x"], slope_y=v["y"]),
}
_OUTSIDE: Mapping[str, str] = {"wheel_wobble": "wobble", "corner_brake": "corner_brake"}


def _scales(length: float, mass: float) -> dict[str, float]:
    """Factor of each parameter; gravity stays, so times go with the root of the length."""
    groups = {
        _LENGTHS: length, _MASSES: mass, _INERTIAS: mass * length**2, _SPRINGS: mass / length,
        _DAMPERS: mass / sqrt(length), _TORSIONS: mass * length, _PER_LENGTH: 1.0 / length,
        ("K_lt",): length / mass,
    }  # fmt: skip
    return {name: factor for names, factor in groups.items() for name in names}


def make_vehicle() -> Any:
    """The BMW, 1:10, driven and braked by a motor on the rear wheels."""
    big = as_tuple(setup_vehicle_parameters(_BMW))
    length = WHEELBASE / (big.a + big.b)
    scales = _scales(length, MASS / big.m)
    small = big._replace(**{name: getattr(big, name) * k for name, k in scales.items()})
    pace = sqrt(length)
    speeds = {
        name: getattr(big.longitudinal, name) * pace for name in ("v_max", "v_min", "v_switch")
    }
    return small._replace(
        longitudinal=big.longitudinal._replace(**speeds),
        # The servo's own limits are in its wiring; the linkage reaches a little further.
        steering=big.steering._replace(max=0.5, min=-0.5, v_max=20.0, v_min=-20.0),
        # The package adds this shift, times a load, to an angle: it has a unit, 1/N.
        tire=big.tire._replace(p_vx1=big.tire.p_vx1 * big.m / MASS),
        T_sb=0.0,
        T_se=0.0,
    )


def draw_car(rng: np.random.Generator) -> Any:
    """A healthy car: rear or all wheels driven, geometry, mass and tyres within 10 %."""

    def about(value: float) -> float:
        return value * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD))

    car = make_vehicle()
    names = ("a", "b", "I_z", "h_s", "T_f", "T_r")
    heavier = about(1.0)
    masses = {name: heavier * getattr(car, name) for name in _MASSES}
    grip = about(1.0)
    tire = car.tire._replace(
        p_dx1=grip * car.tire.p_dx1, p_dy1=grip * car.tire.p_dy1, p_ky1=about(car.tire.p_ky1)
    )
    share = 0.5 if rng.random() < 0.5 else 0.0
    drawn = {name: about(getattr(car, name)) for name in names}
    return car._replace(**drawn, **masses, tire=tire, T_sb=share, T_se=share)


def rolling_mass(car: Any) -> float:
    """What the motor accelerates: the car and the inertia of its wheels [kg]."""
    return float(car.m + 4.0 * car.I_y_w / car.R_w**2)


def rolling(car: Any, states: Array) -> Array:
    """Surface speed of the driven wheels, by their turning [m/s]."""
    first = 23 if car.T_se > 0.0 else 25
    return np.asarray(car.R_w * states[:, first:27].mean(axis=1))


@njit(cache=True)
def _rates(
    x: Array, steering: float, accel: float, push: Array, car: Any, floor: Floor
) -> Array:  # fmt: skip
    """The package's derivative, and what floor and bearings add to it."""
    f = np.array(rhs(x, np.array([steering, accel]), car))
    moving = min(hypot(x[3], x[10]) / _SLOW, 1.0)
    c, s = cos(x[4]), sin(x[4])
    ax = moving * push[0] + GRAVITY * (floor.slope_x * c + floor.slope_y * s)
    ay = moving * push[1] + GRAVITY * (floor.slope_y * c - floor.slope_x * s)
    f[3] += ax
    f[10] += ay
    f[15] += ay
    f[20] += ay
    f[5] += moving * push[2]
    whole = car.m + 4.0 * car.I_y_w / car.R_w**2
    for wheel in range(23, 27):
        rub = 0.25 * whole * floor.drag * car.R_w
        if wheel == 24:
            rub += floor.corner_brake * car.m * GRAVITY * car.R_w
        f[wheel] -= rub * tanh(x[wheel]) / car.I_y_w
    grease = floor.differential * car.I_z * (car.R_w / car.T_r) ** 2 * (x[25] - x[26])
    f[25] -= grease / car.I_y_w
    f[26] += grease / car.I_y_w
    return f


@njit(cache=True)
def _advance(
    x: Array, angle: Array, speed: Array, cut: Array, push: Array, car: Any, floor: Floor,
    motor: tuple[float, float, float, float], parts: int, out: Array,
) -> None:  # fmt: skip
    """Ten milliseconds: loops for steering velocity and acceleration, RK4, states kept in `out`."""
    lag, most, brake, moved = motor
    dt = STEP / parts
    first = 23 if car.T_se > 0.0 else 25
    for i in range(len(angle)):
        out[i] = x
        spin = 0.0
        for wheel in range(first, 27):
            spin += x[wheel] * car.R_w / (27 - first)
        accel = min(max((speed[i] - spin) / max(lag, 2.0 * STEP), -brake), most)
        accel = 0.0 if cut[i] > 0.0 else accel * moved / car.m
        turned = x[0] * cos(x[4]) + x[1] * sin(x[4])
        aim = angle[i] + floor.wobble * x[3] * sin(turned / car.R_w)
        for _ in range(parts):
            steering = (aim - x[2]) / (2.0 * STEP)
            k1 = _rates(x.copy(), steering, accel, push[i], car, floor)
            k2 = _rates(x + 0.5 * dt * k1, steering, accel, push[i], car, floor)
            k3 = _rates(x + 0.5 * dt * k2, steering, accel, push[i], car, floor)
            k4 = _rates(x + dt * k3, steering, accel, push[i], car, floor)
            x += dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            # As the package does in the state it is handed: a wheel does not turn backwards. Left
            # below zero it would have no rate at all, and stand still to the end of the drive.
            x[23:27] = np.maximum(x[23:27], 0.0)


def grip_at(floor: Floor, x: float, y: float, t: float) -> float:
    """Friction of the floor at a place and time, per nominal."""
    gap = hypot(x - floor.patch_x, y - floor.patch_y) - floor.patch_radius
    inside = 0.5 * (1.0 - tanh(gap / _EDGE))
    return exp(floor.grip_rate * max(t, 0.0) / 60.0) * (1.0 - floor.patch_drop * inside)


def _on(car: Any, grip: float) -> Any:
    """The car on a floor of that grip."""
    tire = car.tire._replace(p_dx1=grip * car.tire.p_dx1, p_dy1=grip * car.tire.p_dy1)
    return car._replace(tire=tire)


def simulate(plant: CommonRoadPlant, orders: Any, process: Array, start: Array) -> Array:
    """Drive the car.

    Args:
        plant: the car.
        orders: what reaches servo and motor, per millisecond.
        process: accelerations that push it, per millisecond, rows x, y, yaw of the body.
        start: x, y, yaw, speed.

    Returns:
        The package's 29 states each millisecond.

    Raises:
        FloatingPointError: the model has left what it can compute (a wheel rolls backwards).
    """
    car, floor, w = plant.car, plant.floor, plant.wiring
    n = len(orders.angle)
    x = np.array(
        init_mb([start[0], start[1], orders.angle[0], start[3], start[2], 0.0, 0.0], car), float
    )
    out = np.empty((n, STATES))
    motor = (w.drive_lag, w.accel_max, w.brake_max, plant.motor_mass)
    changing = floor.patch_drop != 0.0 or floor.grip_rate != 0.0
    for i in range(0, n, TICK):
        here = _on(car, grip_at(floor, x[0], x[1], (i - LEAD) * STEP)) if changing else car
        span = slice(i, i + TICK)
        _advance(
            x, orders.angle[span], orders.speed[span], orders.cut[span], process[span], here, floor,
            motor, PARTS, out[span],
        )  # fmt: skip
    if not np.isfinite(out).all():
        raise FloatingPointError("CommonRoad's model has diverged in this drive")
    return out
