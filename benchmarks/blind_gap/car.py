"""The hidden car: every number of the four-wheel plant, healthy values and their spread.

The healthy car is built so that a single-track car with linear tyres is *nearly* right about it;
`mismatch` says how far off that model is allowed to be (0.15 by default, 1 for the structural
controls): tyres that level off, grip that falls with load, power lost to slip in bends.
"""

# Why: docs/decisions/diagnosis.md#d31

from math import sqrt
from typing import NamedTuple

import numpy as np

GRAVITY = 9.81
MISMATCH = 0.15
"""Share of the plant's own structure that the healthy car shows."""
_SPREAD = 0.10


class PlantCar(NamedTuple):
    """Parameters of the plant, SI units; all floats, so that compiled code takes it as it is."""

    mass: float = 3.74
    inertia_z: float = 0.04712
    lf: float = 0.15875
    lr: float = 0.17145
    track: float = 0.24
    pitch_height: float = 0.074
    """Height that moves load between the axles [m]."""
    roll_height: float = 0.074
    """Height that moves load between the sides [m]."""
    ackermann: float = 0.5
    """Share of the geometric difference between the front wheels' angles."""
    mu: float = 1.0489
    stiff_front: float = 4.718
    """Cornering force per friction limit and slip [1/rad]."""
    stiff_rear: float = 5.4562
    stiff_along: float = 22.0
    """Longitudinal force per friction limit and slip ratio."""
    ceiling: float = 4.0
    """Where the brush tyre slides, in units of mu Fz."""
    load_sensitivity: float = 0.05
    """Loss of stiffness coefficient per relative load."""
    relaxation: float = 0.0
    """Rolled distance over which slip is felt [m]."""
    ellipse: float = 0.0
    """Share of lateral force that the longitudinal force takes away."""
    induced: float = 0.15
    """Share of the slip power of bends that the drive does not make good."""
    coupling: float = 0.0
    """Yaw damping of viscous coupling between left and right wheels [1/s]."""
    steer_gain: float = 1.0
    steer_bias: float = 0.0
    linkage_bend: float = 0.85
    """Share of the tangent's curvature that the linkage takes out: 1 gives tan(wheel) = servo."""
    steer_cubic: float = 0.0
    steer_asymmetry: float = 0.0
    steer_play: float = 0.0
    steer_delay: float = 0.01
    steer_lag: float = 0.05
    steer_rate: float = 3.2
    steer_left: float = 0.34
    steer_right: float = 0.34
    steer_stop: float = 1.0
    """A stop that applies on either side [rad]."""
    wheel_mass: float = 0.25
    """Inertia of one wheel and its share of the motor, as mass at the tyre [kg]."""
    front_share: float = 0.25
    """Torque of the front axle; the motor turns with front and rear wheels in that proportion."""
    speed_gain: float = 1.0
    wheel_scale: float = 1.0
    """Size of the wheels per size that the motor controller believes."""
    drive_delay: float = 0.0
    drive_lag: float = 0.10
    accel_max: float = 5.0
    brake_max: float = 5.0
    sag_rate: float = 0.0
    """Speed lost per minute [1/min]."""
    drag: float = 0.0
    """Rolling resistance [m/s^2]."""
    slope_x: float = 0.0
    slope_y: float = 0.0
    patch_x: float = 0.0
    patch_y: float = 0.0
    patch_radius: float = 0.5
    patch_drop: float = 0.0
    patch_orbit: float = 0.0
    """Radius of the circle on which the patch moves about (patch_x, patch_y) [m]."""
    patch_rate: float = 0.0
    """Angular speed of that motion [rad/s]."""
    grip_rate: float = 0.0
    """Growth of grip per minute [1/min]."""
    pose_delay: float = 0.0
    marker_x: float = 0.0
    marker_y: float = 0.0
    marker_yaw: float = 0.0
    swim: float = 0.0
    """Amplitude of a slow movement of the mocap frame [m]."""
    command_step: float = 0.0
    """Grid on which the servo reads its command [rad]."""
    wobble: float = 0.0
    """Amplitude of a shimmy of the front wheels at 1 m/s [rad]."""
    wobble_hz: float = 6.0
    camber_pull: float = 0.0
    """Steering that grows with speed squared [rad s^2/m^2]."""
    torque_steer: float = 0.0
    """Steering that grows with acceleration [rad s^2/m]."""
    rear_play: float = 0.0
    """Toe of a loose rear left wheel, to the side that its force pushes it [rad]."""
    corner_brake: float = 0.0
    """Drag of the front right wheel alone, per weight of the car."""
    ripple: float = 0.0
    """Drive ripple once per half wheel turn [m/s^2]."""


_RANDOM = (
    "inertia_z", "lf", "lr", "stiff_front", "stiff_rear", "track", "steer_lag", "drive_lag",
)  # fmt: skip
"""What identification finds out; mass, limits and the like stay at the published car's figures,
which a car file holds and a scale or a data sheet gives."""


def make_car(rng: np.random.Generator, mismatch: float = MISMATCH) -> PlantCar:
    """A healthy car: what identification fits within 10 %, small trims of its own."""
    base = PlantCar()
    values = {
        name: getattr(base, name) * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD))
        for name in _RANDOM
    }
    values["steer_gain"] = float(rng.uniform(0.95, 1.05))
    values["steer_bias"] = float(rng.uniform(-0.02, 0.02))
    values["steer_delay"] = float(rng.uniform(0.008, 0.02))
    values["speed_gain"] = float(rng.uniform(0.96, 1.04))
    return set_mismatch(base._replace(**values), mismatch)


def set_mismatch(car: PlantCar, mismatch: float) -> PlantCar:
    """The car with that share of what a linear single-track car does not know."""
    return car._replace(
        ceiling=1.0 / sqrt(1e-9 + (mismatch / 0.6) ** 2),
        load_sensitivity=0.35 * mismatch,
        induced=mismatch,
        linkage_bend=1.0 - mismatch,
    )


def wheel_inertia(car: PlantCar) -> float:
    """What spinning wheels add to the yaw inertia: left and right must turn apart [kg m^2]."""
    return car.wheel_mass * car.track * car.track


def grip_loss(car: PlantCar) -> float:
    """Share of an axle's stiffness that load transfer takes at 1 g: sensitivity times square."""
    share = 2.0 * car.roll_height / car.track
    return car.load_sensitivity * share * share
