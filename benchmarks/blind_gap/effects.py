"""What can be wrong with the hidden car, in the plant's own form, by the contract's names.

Each effect has one strength, a positive number; `values` turns it into the contract's parameters
(the label) and `apply` into plant numbers. `weak` and `strong` bracket the strength; for limits the
weak end is the larger number. `table` holds small, medium and large from published magnitudes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import cos, exp, sin, sqrt

import numpy as np

from benchmarks.blind_gap.car import PlantCar, grip_loss, wheel_inertia

Values = dict[str, float]
SIZES = ("small", "medium", "large")


@dataclass(frozen=True, slots=True)
class Place:
    """What an effect may need to know of its case: a sign, a direction, a spot on the floor."""

    sign: float = 1.0
    angle: float = 0.0
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True, slots=True)
class Hidden:
    """One effect of the contract.

    Attributes:
        family: which kind of cause it is.
        units: unit of each parameter.
        null: value of each parameter that changes nothing.
        comparable: parameters whose meaning in the plant is the contract's.
    """

    name: str
    family: str
    units: Mapping[str, str]
    null: Values
    weak: float
    strong: float
    table: tuple[float, float, float]
    values: Callable[[float, Place], Values]
    apply: Callable[[PlantCar, Values], PlantCar]
    comparable: tuple[str, ...]
    needs_place: bool = False


@dataclass(frozen=True, slots=True)
class Outside:
    """A defect that no effect of the contract describes.

    Attributes:
        apply: the car with the defect at a strength.
        freeze: seconds of each servo freeze per strength.
        cut: seconds of each drop-out of the motor per strength.
        jitter: standard deviation of the poses' stamps per strength [s].
    """

    name: str
    table: tuple[float, float, float]
    unit: str
    apply: Callable[[PlantCar, float, Place], PlantCar] = field(default=lambda car, v, place: car)
    freeze: float = 0.0
    cut: float = 0.0
    jitter: float = 0.0
    needs_place: bool = False


def _one(
    name: str,
    family: str,
    parameter: str,
    unit: str,
    span: tuple[float, float],
    table: tuple[float, float, float],
    apply: Callable[[PlantCar, float], PlantCar],
    null: float = 0.0,
    value: Callable[[float, float], float] = lambda v, sign: v,
    comparable: bool = True,
) -> Hidden:
    """An effect of one parameter; `value` makes it of strength and sign."""
    return Hidden(
        name, family, {parameter: unit}, {parameter: null}, *span, table,
        lambda v, place: {parameter: value(v, place.sign)},
        lambda car, values: apply(car, values[parameter]),
        (parameter,) if comparable else (),
    )  # fmt: skip


def _add(attribute: str) -> Callable[[PlantCar, float], PlantCar]:
    return lambda car, v: car._replace(**{attribute: getattr(car, attribute) + v})


def _times(attribute: str) -> Callable[[PlantCar, float], PlantCar]:
    return lambda car, v: car._replace(**{attribute: getattr(car, attribute) * v})


def _least(*attributes: str) -> Callable[[PlantCar, float], PlantCar]:
    return lambda car, v: car._replace(**{a: min(getattr(car, a), v) for a in attributes})


def _signed(v: float, sign: float) -> float:
    return v * sign


def _ratio(v: float, sign: float) -> float:
    return 1.0 + v * sign


def _roll_out(car: PlantCar, deceleration: float) -> PlantCar:
    """What slows a car left to roll by so much: its drag has to slow the wheels' inertia too."""
    whole = (car.mass + 4.0 * car.wheel_mass) / car.mass
    return car._replace(drag=car.drag + whole * deceleration)


def _stiffness(car: PlantCar, ratio: float) -> PlantCar:
    return car._replace(stiff_front=ratio * car.stiff_front, stiff_rear=ratio * car.stiff_rear)


def _balance(car: PlantCar, ratio: float) -> PlantCar:
    root = sqrt(ratio)
    return car._replace(stiff_front=car.stiff_front * root, stiff_rear=car.stiff_rear / root)


def _roll(car: PlantCar, k: float) -> PlantCar:
    """A high body on tyres whose coefficient falls with load: k of the axle's grip lost at 1 g."""
    if k <= 0.0:
        return car
    height = max(car.roll_height, 0.12)
    share = 2.0 * height / car.track
    return car._replace(roll_height=height, load_sensitivity=(grip_loss(car) + k) / share**2)


def _inertia(car: PlantCar, ratio: float) -> PlantCar:
    """The whole yaw inertia scaled, wheels included: what a planar model can see."""
    whole = car.inertia_z + wheel_inertia(car)
    return car._replace(inertia_z=car.inertia_z + (ratio - 1.0) * whole)


def _lock(car: PlantCar, values: Values) -> PlantCar:
    """Viscous coupling of left and right wheels that damps yaw at that rate."""
    whole = (car.inertia_z + wheel_inertia(car)) / car.inertia_z
    return car._replace(coupling=car.coupling + whole * values["yaw_damping"])


def _payload(car: PlantCar, kg: float) -> PlantCar:
    """The motor's force stays, so limits fall; tyre forces grow with load by themselves."""
    share = car.mass / (car.mass + kg)
    return car._replace(
        mass=car.mass + kg, accel_max=car.accel_max * share, brake_max=car.brake_max * share
    )


def _shift_cog(car: PlantCar, d: float) -> PlantCar:
    return car._replace(lf=car.lf - d, lr=car.lr + d, marker_x=car.marker_x - d)


def _marker(car: PlantCar, values: Values) -> PlantCar:
    return car._replace(
        marker_x=car.marker_x + values["forward"], marker_y=car.marker_y + values["left"]
    )


def _patch(car: PlantCar, values: Values) -> PlantCar:
    return car._replace(**{f"patch_{name}": value for name, value in values.items()})


_LIST = (
    _one("steer_delay", "timing", "delay", "s", (0.001, 0.08), (0.01, 0.03, 0.06),
         _add("steer_delay")),
    _one("steer_lag", "steering", "lag", "s", (0.001, 0.15), (0.02, 0.05, 0.1), _add("steer_lag")),
    _one("steer_rate_limit", "steering", "rate", "rad/s", (3.19, 0.5), (2.4, 1.6, 1.0),
         _least("steer_rate"), null=50.0),
    _one("steer_bias", "steering", "bias", "rad", (0.0002, 0.05), (0.005, 0.015, 0.03),
         _add("steer_bias"), value=_signed),
    _one("steer_gain", "steering", "gain", "1", (0.002, 0.3), (0.05, 0.1, 0.2),
         _times("steer_gain"), null=1.0, value=_ratio),
    _one("steer_nonlinearity", "steering", "cubic", "1/rad^2", (0.05, 2.5), (0.5, 1.0, 2.0),
         _add("steer_cubic"), value=lambda v, sign: -v),
    _one("steer_asymmetry", "steering", "asymmetry", "1", (0.003, 0.3), (0.05, 0.1, 0.2),
         _add("steer_asymmetry"), value=_signed),
    _one("steer_clip", "steering", "limit", "rad", (0.339, 0.08), (0.26, 0.2, 0.14),
         _least("steer_stop"), null=1.0),
    _one("steer_backlash", "steering", "play", "rad", (0.001, 0.08), (0.01, 0.02, 0.04),
         _add("steer_play")),
    _one("drive_delay", "timing", "delay", "s", (0.001, 0.15), (0.02, 0.05, 0.1),
         _add("drive_delay")),
    _one("drive_lag", "drive", "lag", "s", (0.002, 0.4), (0.05, 0.1, 0.2), _add("drive_lag")),
    _one("accel_limit", "drive", "limit", "m/s^2", (4.99, 0.5), (3.0, 2.0, 1.0),
         _least("accel_max", "brake_max"), null=20.0),
    _one("speed_scale", "drive", "scale", "1", (0.001, 0.15), (0.02, 0.05, 0.08),
         _times("wheel_scale"), null=1.0, value=_ratio),
    _one("rolling_drag", "drive", "drag", "m/s^2", (0.01, 1.5), (0.2, 0.4, 0.8), _roll_out),
    _one("battery_sag", "drive", "rate", "1/min", (0.005, 0.8), (0.05, 0.1, 0.2),
         _add("sag_rate")),
    _one("tyre_friction", "tyre", "ratio", "1", (0.01, 0.6), (0.1, 0.2, 0.4), _times("mu"),
         null=1.0, value=lambda v, sign: 1.0 - v),
    _one("cornering_stiffness", "tyre", "ratio", "1", (0.01, 0.5), (0.1, 0.2, 0.35), _stiffness,
         null=1.0, value=_ratio),
    _one("tyre_balance", "tyre", "ratio", "1", (0.01, 0.6), (0.1, 0.2, 0.4), _balance,
         null=1.0, value=lambda v, sign: exp(v * sign)),
    _one("tyre_relaxation", "tyre", "length", "m", (0.003, 0.4), (0.03, 0.06, 0.12),
         _add("relaxation")),
    _one("friction_ellipse", "tyre", "share", "1", (0.05, 6.0), (0.5, 1.0, 3.0), _add("ellipse"),
         comparable=False),
    _one("lateral_load_transfer", "tyre", "k", "1", (0.02, 3.0), (0.3, 0.8, 1.5), _roll),
    _one("longitudinal_load_transfer", "tyre", "height", "m", (0.003, 0.15), (0.02, 0.05, 0.1),
         _add("pitch_height")),
    _one("grip_drift", "tyre", "rate", "1/min", (0.02, 1.2), (0.1, 0.3, 0.6), _add("grip_rate"),
         value=_signed),
    Hidden("grip_patch", "ground", {"x": "m", "y": "m", "radius": "m", "drop": "1"},
           {"x": 0.0, "y": 0.0, "radius": 0.5, "drop": 0.0}, 0.02, 0.8, (0.2, 0.35, 0.6),
           lambda v, place: {"x": place.x, "y": place.y, "radius": 0.6, "drop": v}, _patch,
           ("drop",), needs_place=True),
    Hidden("scrub", "tyre", {"yaw_damping": "1/s", "drag": "1"}, {"yaw_damping": 0.0, "drag": 0.0},
           0.05, 12.0, (1.0, 2.0, 4.0),
           lambda v, place: {"yaw_damping": v, "drag": 0.0},
           _lock,
           ("yaw_damping",)),
    _one("mass", "mass", "payload", "kg", (0.1, 3.0), (0.3, 0.7, 1.5), _payload),
    _one("cog_offset", "mass", "offset", "m", (0.001, 0.05), (0.008, 0.015, 0.03), _shift_cog,
         value=_signed),
    _one("yaw_inertia", "mass", "ratio", "1", (0.02, 1.5), (0.15, 0.3, 0.6), _inertia,
         null=1.0, value=lambda v, sign: 1.0 + v),
    Hidden("floor_slope", "ground", {"x": "rad", "y": "rad"}, {"x": 0.0, "y": 0.0}, 0.0003, 0.04,
           (0.004, 0.008, 0.017),
           lambda v, place: {"x": v * cos(place.angle), "y": v * sin(place.angle)},
           lambda car, v: car._replace(slope_x=v["x"], slope_y=v["y"]), ("x", "y")),
    _one("mocap_latency", "timing", "latency", "s", (0.001, 0.15), (0.01, 0.02, 0.05),
         _add("pose_delay")),
    Hidden("marker_offset", "sensor", {"forward": "m", "left": "m"}, {"forward": 0.0, "left": 0.0},
           0.0005, 0.08, (0.01, 0.02, 0.04),
           lambda v, place: {"forward": v * cos(place.angle), "left": v * sin(place.angle)},
           _marker, ("forward", "left")),
    _one("mocap_yaw", "sensor", "offset", "rad", (0.0003, 0.06), (0.005, 0.01, 0.02),
         _add("marker_yaw"), value=_signed),
)  # fmt: skip
EFFECTS: Mapping[str, Hidden] = {effect.name: effect for effect in _LIST}
FAMILY: Mapping[str, str] = {effect.name: effect.family for effect in _LIST}


def _with(attribute: str, signed: bool = False) -> Callable[[PlantCar, float, Place], PlantCar]:
    return lambda car, v, place: car._replace(**{attribute: v * (place.sign if signed else 1.0)})


def _wander(car: PlantCar, v: float, place: Place) -> PlantCar:
    return car._replace(
        patch_x=place.x, patch_y=place.y, patch_radius=0.8, patch_drop=v,
        patch_orbit=1.2, patch_rate=0.7,
    )  # fmt: skip


OUTSIDE: Mapping[str, Outside] = {
    kind.name: kind
    for kind in (
        Outside("servo_freeze", (0.08, 0.15, 0.3), "s", freeze=1.0),
        Outside("wheel_wobble", (0.005, 0.01, 0.02), "rad s/m", _with("wobble")),
        Outside("stamp_jitter", (0.003, 0.006, 0.012), "s", jitter=1.0),
        Outside("quantised_commands", (0.02, 0.04, 0.08), "rad", _with("command_step")),
        Outside("loose_wheel", (0.01, 0.025, 0.05), "rad", _with("rear_play")),
        Outside("camber_pull", (0.001, 0.003, 0.006), "rad s^2/m^2", _with("camber_pull", True)),
        Outside("moving_patch", (0.25, 0.45, 0.7), "1", _wander, needs_place=True),
        Outside("corner_brake", (0.01, 0.02, 0.04), "1", _with("corner_brake")),
        Outside("torque_steer", (0.004, 0.008, 0.016), "rad s^2/m", _with("torque_steer", True)),
        Outside("drive_ripple", (1.0, 2.0, 4.0), "m/s^2", _with("ripple")),
        Outside("drive_dropout", (0.15, 0.3, 0.6), "s", cut=1.0),
        Outside("mocap_swim", (0.005, 0.012, 0.03), "m", _with("swim")),
    )
}

COMMON_PAIRS = (
    ("steer_delay", "speed_scale"), ("steer_bias", "tyre_friction"),
    ("steer_backlash", "steer_lag"), ("steer_gain", "rolling_drag"),
    ("mocap_latency", "marker_offset"), ("tyre_friction", "drive_lag"),
    ("steer_rate_limit", "steer_gain"), ("cog_offset", "yaw_inertia"),
    ("speed_scale", "mocap_yaw"), ("floor_slope", "steer_bias"),
    ("tyre_balance", "steer_delay"), ("battery_sag", "grip_drift"),
    ("steer_asymmetry", "accel_limit"), ("steer_clip", "cornering_stiffness"),
    ("steer_nonlinearity", "drive_delay"), ("scrub", "steer_lag"),
)  # fmt: skip
"""Pairs that one cause brings about, or that workshops know."""


def draw_place(rng: np.random.Generator) -> Place:
    """A sign and a direction; the spot is filled in from the drive."""
    return Place(float(rng.choice((-1.0, 1.0))), float(rng.uniform(0.0, 2.0 * np.pi)))
