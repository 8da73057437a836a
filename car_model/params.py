"""The car: its parameters as a tuple over the number type, and what is known about each.

`Car` is what the equations take. `PARAMETERS` says for each field its unit, physical bounds and
source, once, for the car file, the identification's priors and the documentation.
"""

from typing import Generic, NamedTuple

from steerd.car_model.ops import T

GRAVITY = 9.81  # [m/s^2], the value the paper and CommonRoad use


class Car(NamedTuple, Generic[T]):
    """Parameters of the single-track car and its actuators. SI units; see `PARAMETERS`."""

    lf: T
    lr: T
    c_sf: T
    c_sr: T
    c_x: T
    mu: T
    inertia_z: T
    mass: T
    cog_height: T
    steer_gain: T
    steer_bias: T
    steer_delay: T
    steer_lag: T
    steer_rate: T
    steer_min: T
    steer_max: T
    speed_gain: T
    speed_lag: T
    drive_delay: T
    accel_max: T
    decel_max: T
    pose_delay: T


class Parameter(NamedTuple):
    """One number of the car: its meaning, physical bounds and where the default comes from."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    meaning: str
    source: str


_GYM = "f1tenth_gym's published vehicle (system identification of the F1TENTH car)"
_STACK = "F1TENTH stack's vesc.yaml"
_PAPER = "IROS 2023 paper"
_ESTIMATE = "engineering estimate; identify replaces it"

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("lf", 0.15875, 0.005, 3.0, "m", "CoG to front axle", _GYM),
    Parameter("lr", 0.17145, 0.005, 3.0, "m", "CoG to rear axle", _GYM),
    Parameter("c_sf", 4.718, 0.5, 40.0, "1/rad", "front cornering coefficient cf/(mu Fz)", _GYM),
    Parameter("c_sr", 5.4562, 0.5, 40.0, "1/rad", "rear cornering coefficient cr/(mu Fz)", _GYM),
    Parameter("c_x", 15.0, 2.0, 200.0, "1", "longitudinal coefficient Fx/(mu Fz slip)", _ESTIMATE),
    Parameter("mu", 1.0489, 0.05, 2.0, "1", "friction coefficient", _GYM),
    Parameter("inertia_z", 0.04712, 1e-6, 1e4, "kg m^2", "yaw inertia about the CoG", _GYM),
    Parameter("mass", 3.74, 0.02, 5000.0, "kg", "mass", _GYM),
    Parameter("cog_height", 0.074, 0.0, 1.5, "m", "height of the CoG", _GYM),
    Parameter("steer_gain", 1.0, 0.05, 5.0, "1", "wheel angle per commanded angle", "nominal"),
    Parameter("steer_bias", 0.0, -0.2, 0.2, "rad", "wheel angle at command zero", "nominal"),
    Parameter("steer_delay", 0.01, 0.0, 0.3, "s", "dead time, command to servo", "servo frame/2"),
    Parameter("steer_lag", 0.05, 0.0, 0.5, "s", "first-order lag of the servo", _ESTIMATE),
    Parameter("steer_rate", 3.2, 0.5, 50.0, "rad/s", "slew limit of the wheel angle", _STACK),
    Parameter("steer_min", -0.34, -1.0, 0.0, "rad", "rightmost wheel angle", _PAPER),
    Parameter("steer_max", 0.34, 0.0, 1.0, "rad", "leftmost wheel angle", _PAPER),
    Parameter("speed_gain", 1.0, 0.5, 1.5, "1", "true speed per reported wheel speed", "nominal"),
    Parameter("speed_lag", 0.1, 0.0, 2.0, "s", "first-order lag of the speed loop", _ESTIMATE),
    Parameter("drive_delay", 0.0, 0.0, 0.3, "s", "dead time, command to motor", "nominal"),
    Parameter("accel_max", 5.0, 0.5, 20.0, "m/s^2", "largest acceleration", "VESC ERPM ramp"),
    Parameter("decel_max", 5.0, 0.5, 20.0, "m/s^2", "largest deceleration", "VESC ERPM ramp"),
    Parameter("pose_delay", 0.0, 0.0, 0.3, "s", "pose latency not in its time stamp", "nominal"),
)

DEFAULT_CAR: Car[float] = Car(*(p.default for p in PARAMETERS))
PAPER_CAR: Car[float] = DEFAULT_CAR._replace(mass=3.1)
"""The car of the paper's simulations: as DEFAULT_CAR, mass 3.1 kg."""

assert tuple(p.name for p in PARAMETERS) == Car._fields  # noqa: S101


def wheelbase(car: Car[T]) -> T:
    """Distance between the axles [m]."""
    length: T = car.lf + car.lr
    return length
