"""The planar single-track chassis: exact angles, forces in the wheel's frame, slip of drive wheels.

Newton and Euler for a rigid body on two axles (Rajamani, Vehicle Dynamics and Control, section 2.3,
without its small angles; longitudinal slip as in Pacejka, Tire and Vehicle Dynamics, section 1.2):

    m a_x = F_x - F_yf sin(delta),  m a_y = F_yf cos(delta) + F_yr,
    a_x = dv_x/dt - r v_y,  a_y = dv_y/dt + r v_x,
    I_z dr/dt = l_f F_yf cos(delta) - l_r F_yr

with the drive force `F_x` acting along the driven wheels. `State.speed` is the speed at which the
driven wheels roll, which a motor controller reports and controls. They carry `F_x`, so they turn
faster than the ground passes by the slip `kappa = F_x / (mu C_x F_z)`. Slip settles within
v / (mu C_x g), some 10 ms: it is taken as settled, which costs less than half a millimetre for a
step of 5 m/s^2, and the model stays as soft as the paper's. Body velocities are kept as `v_x` and
the side-slip angle, `v_y = v_x tan(beta)`.
"""

from functools import cache, partial

from steerd.car_model.chassis import (
    KINEMATIC_RATE,
    SPEED_KINEMATIC,
    Axles,
    Chassis,
    Rates,
    dynamic_share,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK, loads_at
from steerd.car_model.state import State

DRIVES: dict[str, float] = {"rear": 0.0, "all": 0.5, "front": 1.0}
"""Share of the drive force at the front axle, by the car file's word."""


def body_acceleration(ops: Ops[T], state: State[T], accel: T) -> T:
    """Longitudinal acceleration that the body feels [m/s^2]: `dv_x/dt - r v_y`."""
    felt: T = accel - state.yaw_rate * state.speed * ops.tan(state.slip_angle)
    return felt


def slip_per_force(car: Car[T], loads: Axles[T], front: float) -> T:
    """Longitudinal slip of the driven wheels per drive force [1/N]: `1 / (mu C_x F_z)`."""
    driven: T = min(1.0, 2.0 * (1.0 - front)) * loads.rear + min(1.0, 2.0 * front) * loads.front
    compliance: T = 1.0 / (car.mu * car.c_x * driven)
    return compliance


def along_body(ops: Ops[T], car: Car[T], state: State[T], wheel: T, slip: T, front: float) -> T:
    """Speed of the CoG along the body's x axis [m/s], from the driven wheels' rolling speed.

    A driven front axle rolls along its wheels: `v_x cos(delta) + (v_y + l_f r) sin(delta)`.
    """
    ground: T = state.speed * (1.0 - slip)
    if not front:
        return ground
    sine, cosine = ops.sin(wheel), ops.cos(wheel)
    turned = (1.0 - front) + front * (cosine + ops.tan(state.slip_angle) * sine)
    speed: T = (ground - front * car.lf * state.yaw_rate * sine) / turned
    return speed


def slip_angles(
    ops: Ops[T], car: Car[T], state: State[T], wheel: T, accel: T, front: float = 0.0
) -> Axles[T]:
    """Slip angle of each axle [rad]: wheel angle less the direction in which the axle moves.

    The wheels' slip is that of the drive force without cornering drag, which follows from these
    angles: a share of 1e-4 of the angle at most.
    """
    loads = axle_loads(ops, car, state, accel)
    slip = car.mass * body_acceleration(ops, state, accel) * slip_per_force(car, loads, front)
    speed = ops.maximum(along_body(ops, car, state, wheel, slip, front), SPEED_KINEMATIC)
    sideways, spin = ops.tan(state.slip_angle), state.yaw_rate / speed
    return Axles(wheel - ops.atan(sideways + car.lf * spin), -ops.atan(sideways - car.lr * spin))


def axle_loads(ops: Ops[T], car: Car[T], state: State[T], accel: T) -> Axles[T]:
    """Vertical load of each axle [N], moved by the acceleration that the body feels."""
    return loads_at(car, body_acceleration(ops, state, accel))


def chassis_rates(
    ops: Ops[T],
    car: Car[T],
    state: State[T],
    wheel: T,
    accel: T,
    loads: Axles[T],
    forces: Axles[T],
    front: float = 0.0,
) -> Rates[T]:
    """Newton and Euler for the planar body, blended into the kinematic car at crawling speed."""
    slip_angle, yaw_rate = state.slip_angle, state.yaw_rate
    sine, cosine = ops.sin(wheel), ops.cos(wheel)
    share = dynamic_share(ops, state.speed)
    felt = body_acceleration(ops, state, accel)
    drive = car.mass * felt + share * forces.front * sine
    if front:
        drive = drive / ((1.0 - front) + front * cosine)
    slip = drive * slip_per_force(car, loads, front)
    speed = along_body(ops, car, state, wheel, slip, front)
    side_front = forces.front * cosine
    if front:
        side_front = side_front + front * drive * sine
    sideways = (side_front + forces.rear) / car.mass
    course_cos, course_sin = ops.cos(slip_angle), ops.sin(slip_angle)
    along = ops.maximum(speed, SPEED_KINEMATIC) / course_cos
    turn = (sideways * course_cos - felt * course_sin) / along
    yaw_accel = (car.lf * side_front - car.lr * forces.rear) / car.inertia_z
    tangent, base = ops.tan(wheel), car.lf + car.lr
    crawl = (1.0 - share) * KINEMATIC_RATE
    travel = speed / course_cos
    course = state.yaw + slip_angle
    return Rates(
        travel * ops.cos(course),
        travel * ops.sin(course),
        yaw_rate,
        accel,
        share * yaw_accel + crawl * (speed * tangent / base - yaw_rate),
        share * (turn - yaw_rate) + crawl * (ops.atan(car.lr * tangent / base) - slip_angle),
    )


@cache
def make_planar(drive: str = "rear") -> Chassis:
    """The planar chassis with these wheels driven, always the same value for the same drive.

    Args:
        drive: `rear`, `front` or `all`.

    Raises:
        ValueError: it is none of these.
    """
    if drive not in DRIVES:
        raise ValueError(f"drive is {drive!r}; one of {', '.join(DRIVES)}")
    front = DRIVES[drive]
    slips, rates = partial(slip_angles, front=front), partial(chassis_rates, front=front)
    return Chassis("planar", drive, slips, axle_loads, rates)


PLANAR = make_planar("all")  # the default of new car files: F1TENTH cars drive all four wheels
CHASSIS: tuple[Chassis, ...] = (SINGLE_TRACK, *map(make_planar, DRIVES))
"""All that there are, in the order in which machine code numbers them."""
CHASSIS_NAMES: tuple[str, ...] = (SINGLE_TRACK.name, PLANAR.name)


def find_chassis(name: str, drive: str) -> Chassis:
    """The chassis of that name; `drive` matters to the planar one only.

    Raises:
        ValueError: there is none, or `drive` is not one of `DRIVES`.
    """
    if name == SINGLE_TRACK.name:
        return SINGLE_TRACK
    if name == "planar":
        return make_planar(drive)
    raise ValueError(f"no chassis {name!r}; one of {', '.join(CHASSIS_NAMES)}")
