"""The hidden plant: four wheels on brush tyres, compiled, one millisecond RK4.

Written from textbook physics for this test alone; it imports nothing of `car_model`. Body frame at
the centre of gravity, x forward, y left. Chassis state of the integrator: x, y, yaw, vx, vy,
yaw_rate, then the surface speeds of the four wheels (front left, front right, rear left, rear
right). Actuators, delay lines, load filter and slip memory advance once a millisecond.
"""

from dataclasses import dataclass
from math import cos, exp, hypot, pi, sin, sqrt, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.blind_gap.car import GRAVITY, PlantCar

Array = NDArray[np.float64]

STEP = 1e-3
"""Integration step [s]."""
TICK = 10
"""Steps between commands and between poses: 100 Hz."""
_SLOW = 0.5
"""Below this speed slip is measured against it [m/s]."""
_EDGE = 0.08
"""Half width of a patch's edge [m]."""
_LOAD_TIME = 0.012
"""How fast wheel loads follow the accelerations [s]."""
_MEMORY = 9
"""Slip memory of four wheels, filtered accelerations along and across, servo, angle behind its
play, front wheels' angle of the step before."""


@dataclass(frozen=True, slots=True)
class Orders:
    """What the car is commanded, and what fails while it drives; all arrays start at the lead-in.

    Attributes:
        steer: commanded wheel angle every 10 ms [rad]; ignored on a route.
        speed: commanded speed every 10 ms [m/s]; a route may lower it.
        route: rows x, y, curvature of a closed route, 0 rows for open-loop driving.
        route_accel: lateral acceleration to keep to on a route [m/s^2].
        held: 1 per millisecond in which the servo stands still.
        cut: 1 per millisecond in which the motor gives nothing.
    """

    steer: Array
    speed: Array
    route: Array
    route_accel: float
    held: Array
    cut: Array


@dataclass(frozen=True, slots=True)
class Noise:
    """Disturbances: accelerations per step (n, 3) and pose errors per tick (n/10, 3)."""

    process: Array
    pose: Array


@dataclass(frozen=True, slots=True)
class Trace:
    """What happened: states per step (n, 10), and per tick commands and poses with errors."""

    states: Array
    commands: Array
    poses: Array


@njit(cache=True, inline="always")
def _brush(sx: float, sy: float, limit: float) -> tuple[float, float]:
    """Brush tyre (Fiala): force per load along and across, from stiffness times slip."""
    s = hypot(sx, sy)
    if s < 1e-12:
        return sx, sy
    z = s / (3.0 * limit)
    share = 1.0 - z + z * z / 3.0 if z < 1.0 else limit / s
    return sx * share, sy * share


@njit(cache=True)
def _grip(car: PlantCar, x: float, y: float, t: float) -> float:
    """Friction of the floor at a place and time, per nominal friction."""
    cx = car.patch_x + car.patch_orbit * cos(car.patch_rate * t)
    cy = car.patch_y + car.patch_orbit * sin(car.patch_rate * t)
    inside = 0.5 * (1.0 - tanh((hypot(x - cx, y - cy) - car.patch_radius) / _EDGE))
    return exp(car.grip_rate * t / 60.0) * (1.0 - car.patch_drop * inside)


@njit(cache=True)
def _slip(car: PlantCar, s: Array, wheel: int, angle: float) -> tuple[float, float, float]:
    """Velocity along and across a wheel [m/s] and its slip angle [rad]."""
    px = car.lf if wheel < 2 else -car.lr
    py = 0.5 * car.track if wheel % 2 == 0 else -0.5 * car.track
    vx, vy = s[3] - s[5] * py, s[4] + s[5] * px
    along = vx * cos(angle) + vy * sin(angle)
    across = vy * cos(angle) - vx * sin(angle)
    return along, across, -np.arctan(across / max(abs(along), _SLOW))


@njit(cache=True)
def _angle(car: PlantCar, wheel: int, steer: float, toe: float) -> float:
    """Angle of one wheel: the inner front wheel turns further; a loose rear wheel has toe."""
    if wheel < 2:
        side = -1.0 if wheel == 0 else 1.0
        spread = car.ackermann * car.track / (car.lf + car.lr)
        return steer - 0.5 * side * spread * steer * steer
    return toe if wheel == 2 else 0.0


@njit(cache=True)
def _load(car: PlantCar, wheel: int, ax: float, ay: float) -> float:
    """Load of one wheel [N], never negative."""
    base = car.lf + car.lr
    half = 0.5 * car.mass * GRAVITY / base
    static = half * (car.lr if wheel < 2 else car.lf)
    pitch = 0.5 * car.mass * ax * car.pitch_height / base
    roll = 0.5 * car.mass * ay * car.roll_height / car.track
    load = static + (-pitch if wheel < 2 else pitch) + (-roll if wheel % 2 == 0 else roll)
    return max(load, 0.0)


@njit(cache=True)
def _wheel_force(
    car: PlantCar, s: Array, m: Array, wheel: int, angle: float, grip: float
) -> tuple[float, float, float]:
    """Force along and across one wheel [N] and the power that lateral slip takes [W]."""
    along, across, slip = _slip(car, s, wheel, angle)
    load = _load(car, wheel, m[4], m[5])
    static = _load(car, wheel, 0.0, 0.0)
    stiff = car.stiff_front if wheel < 2 else car.stiff_rear
    stiff *= 1.0 - car.load_sensitivity * (load / static - 1.0)
    spin = s[6 + wheel]
    ratio = (spin - along) / max(abs(spin), abs(along), _SLOW)
    fx, fy = _brush(car.stiff_along * ratio, max(stiff, 0.0) * (slip + m[wheel]), car.ceiling)
    fy *= sqrt(max(1.0 - car.ellipse * fx * fx, 0.01))
    scale = car.mu * grip * load
    return scale * fx, scale * fy, -scale * fy * across


@njit(cache=True)
def _rates(
    car: PlantCar, s: Array, m: Array, w: Array, steer: float, accel: float, t: float, out: Array
) -> None:
    """Time derivatives of the integrator's state; `w` holds the disturbance accelerations."""
    c, si = cos(s[2]), sin(s[2])
    grip = _grip(car, s[0], s[1], t)
    moving = min(hypot(s[3], s[4]) / _SLOW, 1.0)
    toe = car.rear_play * tanh(5.0 * m[5])
    force_x = force_y = moment = slip_power = 0.0
    for wheel in range(4):
        angle = _angle(car, wheel, steer, toe)
        fx, fy, power = _wheel_force(car, s, m, wheel, angle, grip)
        bx, by = fx * cos(angle) - fy * sin(angle), fx * sin(angle) + fy * cos(angle)
        px = car.lf if wheel < 2 else -car.lr
        py = 0.5 * car.track if wheel % 2 == 0 else -0.5 * car.track
        if wheel == 1:
            bx -= car.corner_brake * car.mass * GRAVITY * tanh(10.0 * s[3])
        force_x += bx
        force_y += by
        moment += px * by - py * bx
        slip_power += power
        other = s[6 + (wheel ^ 1)]
        link = car.coupling * car.inertia_z / (2.0 * car.track * car.track) * (other - s[6 + wheel])
        share = car.front_share if wheel < 2 else 1.0 - car.front_share
        drive = 0.5 * share * (car.mass + 4.0 * car.wheel_mass) * accel
        out[6 + wheel] = (drive + link - fx) / car.wheel_mass
    force_x += (1.0 - car.induced) * slip_power / max(abs(s[3]), _SLOW)
    slope_along = GRAVITY * (car.slope_x * c + car.slope_y * si)
    slope_across = GRAVITY * (car.slope_y * c - car.slope_x * si)
    ax = force_x / car.mass - car.drag * tanh(10.0 * s[3]) + slope_along + moving * w[0]
    ay = force_y / car.mass + slope_across + moving * w[1]
    out[0] = s[3] * c - s[4] * si
    out[1] = s[3] * si + s[4] * c
    out[2] = s[5]
    out[3] = ax + s[5] * s[4]
    out[4] = ay - s[5] * s[3]
    out[5] = moment / car.inertia_z + moving * w[2]


@njit(cache=True)
def _rk4(
    car: PlantCar, s: Array, m: Array, w: Array, steer: float, accel: float, t: float, k: Array
) -> None:
    """One step of the classical Runge-Kutta method, in place; `k` is scratch of five rows."""
    _rates(car, s, m, w, steer, accel, t, k[0])
    for i in range(10):
        k[4, i] = s[i] + 0.5 * STEP * k[0, i]
    _rates(car, k[4], m, w, steer, accel, t + 0.5 * STEP, k[1])
    for i in range(10):
        k[4, i] = s[i] + 0.5 * STEP * k[1, i]
    _rates(car, k[4], m, w, steer, accel, t + 0.5 * STEP, k[2])
    for i in range(10):
        k[4, i] = s[i] + STEP * k[2, i]
    _rates(car, k[4], m, w, steer, accel, t + STEP, k[3])
    for i in range(10):
        s[i] += STEP / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@njit(cache=True)
def _late(line: Array, step: int, delay: float, column: int) -> float:
    """A value of a delay line, `delay` seconds old; the first value stands for all before it."""
    at = max(step - delay / STEP, 0.0)
    low = int(at)
    high = min(low + 1, step)
    share = at - low
    return float(line[low, column] * (1.0 - share) + line[high, column] * share)


@njit(cache=True)
def _servo(car: PlantCar, m: Array, command: float, held: bool) -> None:
    """Servo and linkage over one step: `m[6]` servo angle, `m[7]` angle behind the play."""
    if car.command_step > 0.0:
        command = car.command_step * np.round(command / car.command_step)
    aim = min(max(car.steer_gain * command + car.steer_bias, -car.steer_right), car.steer_left)
    aim = min(max(aim, -car.steer_stop), car.steer_stop)
    if not held:
        move = (aim - m[6]) * (1.0 - exp(-STEP / max(car.steer_lag, 1e-5)))
        most = car.steer_rate * STEP
        m[6] += min(max(move, -most), most)
    half = 0.5 * car.steer_play
    m[7] = min(max(m[7], m[6] - half), m[6] + half)


@njit(cache=True)
def _wheel_angle(car: PlantCar, s: Array, m: Array, t: float) -> float:
    """Mean angle of the front wheels: the linkage bends, pulls and shakes."""
    angle = m[7] - car.linkage_bend * (m[7] - np.arctan(m[7]))
    angle += car.steer_asymmetry * abs(m[7]) + car.steer_cubic * m[7] ** 3
    angle += car.camber_pull * s[3] * s[3] + car.torque_steer * m[4]
    return float(angle + car.wobble * abs(s[3]) * sin(2.0 * pi * car.wobble_hz * t))


@njit(cache=True)
def motor_speed(car: PlantCar, s: Array) -> float:
    """Surface speed that the motor turns the wheels with, through open differentials [m/s]."""
    front, rear = 0.5 * (s[6] + s[7]), 0.5 * (s[8] + s[9])
    return float(car.front_share * front + (1.0 - car.front_share) * rear)


@njit(cache=True)
def _motor(car: PlantCar, s: Array, command: float, t: float, cut: bool) -> float:
    """Acceleration that the motor asks of car and wheels: a speed loop with current limits."""
    if cut:
        return 0.0
    sag = exp(-car.sag_rate * max(t, 0.0) / 60.0)
    aim = car.speed_gain * car.wheel_scale * sag * command
    accel = (aim - motor_speed(car, s)) / max(car.drive_lag, 2.0 * STEP)
    accel = min(max(accel, -car.brake_max), car.accel_max)
    turned = s[0] * cos(s[2]) + s[1] * sin(s[2])
    return float(accel + car.ripple * sin(2.0 * turned / 0.055))


@njit(cache=True)
def _steered(car: PlantCar, s: Array, m: Array, steer: float) -> None:
    """What turning the front wheels adds to their slip is not felt yet."""
    if car.relaxation > 0.0:
        for wheel in range(2):
            m[wheel] -= _slip(car, s, wheel, _angle(car, wheel, steer, 0.0))[2]
            m[wheel] += _slip(car, s, wheel, _angle(car, wheel, m[8], 0.0))[2]
    m[8] = steer


@njit(cache=True)
def _remember(car: PlantCar, before: Array, s: Array, m: Array, steer: float) -> None:
    """Slip memory and load filter after a step."""
    ax = (s[3] - before[3]) / STEP - s[5] * s[4]
    ay = (s[4] - before[4]) / STEP + s[5] * s[3]
    fade = exp(-STEP / _LOAD_TIME)
    m[4] = ax + (m[4] - ax) * fade
    m[5] = ay + (m[5] - ay) * fade
    if car.relaxation <= 0.0:
        return
    keep = exp(-STEP * max(abs(s[3]), _SLOW) / car.relaxation)
    for wheel in range(4):
        angle = _angle(car, wheel, steer, 0.0)
        change = _slip(car, s, wheel, angle)[2] - _slip(car, before, wheel, angle)[2]
        m[wheel] = (m[wheel] - change) * keep


@njit(cache=True)
def _seen(car: PlantCar, states: Array, step: int, t: float, out: Array) -> None:
    """The pose that mocap reports: late, of another point, turned, in a frame that swims."""
    x = _late(states, step, car.pose_delay, 0)
    y = _late(states, step, car.pose_delay, 1)
    yaw = _late(states, step, car.pose_delay, 2)
    out[0] = x + cos(yaw) * car.marker_x - sin(yaw) * car.marker_y
    out[1] = y + sin(yaw) * car.marker_x + cos(yaw) * car.marker_y
    out[0] += car.swim * sin(0.9 * t)
    out[1] += car.swim * cos(0.65 * t)
    out[2] = yaw + car.marker_yaw


@njit(cache=True)
def _nearest(route: Array, x: float, y: float, start: int, span: int) -> int:
    """Index of the route's nearest point, looked for ahead of the last one."""
    best, nearest = start, 1e18
    for i in range(span):
        at = (start + i) % len(route)
        d = (route[at, 0] - x) ** 2 + (route[at, 1] - y) ** 2
        if d < nearest:
            nearest, best = d, at
    return best


@njit(cache=True)
def _pursue(
    route: Array, pose: Array, speed: float, at: int, limit: float
) -> tuple[float, float, int]:
    """Pure pursuit: steering towards a point ahead, and the speed that the next bends allow."""
    gap = hypot(route[1, 0] - route[0, 0], route[1, 1] - route[0, 1])
    at = _nearest(route, pose[0], pose[1], at, max(int(1.0 / gap), 8))
    ahead = 0.35 + 0.22 * speed
    target = (at + int(ahead / gap)) % len(route)
    dx, dy = route[target, 0] - pose[0], route[target, 1] - pose[1]
    left = -sin(pose[2]) * dx + cos(pose[2]) * dy
    steer = np.arctan(0.33 * 2.0 * left / max(dx * dx + dy * dy, 0.01))
    bend = 1e-3
    for i in range(0, int(0.8 / gap), 2):
        bend = max(bend, abs(route[(at + i) % len(route), 2]))
    return min(max(steer, -0.34), 0.34), min(speed, sqrt(limit / bend)), at


@njit(cache=True, nogil=True)
def _simulate(
    car: PlantCar,
    later: PlantCar,
    change: int,
    start: Array,
    lead: int,
    steer: Array,
    speed: Array,
    route: Array,
    route_accel: float,
    held: Array,
    cut: Array,
    process: Array,
    pose_noise: Array,
    states: Array,
    commands: Array,
    poses: Array,
) -> None:
    """March the car through `len(states)` steps; fill states, and per tick commands and poses."""
    s, m, scratch = start.copy(), np.zeros(_MEMORY), np.zeros((5, 10))
    line = np.zeros((len(states), 2))
    spot, now = np.zeros(3), np.zeros(2)
    place = _nearest(route, s[0], s[1], 0, len(route)) if len(route) else 0
    for step in range(len(states)):
        t = (step - lead) * STEP
        if step == change:
            car = later
        for i in range(10):
            states[step, i] = s[i]
        if step % TICK == 0:
            tick = step // TICK
            _seen(car, states, step, t, spot)
            for i in range(3):
                poses[tick, i] = spot[i] + pose_noise[tick, i]
            now[0], now[1] = steer[tick], speed[tick]
            if len(route):
                now[0], now[1], place = _pursue(
                    route, poses[max(tick - 1, 0)], speed[tick], place, route_accel
                )
            commands[tick] = now
        line[step] = now
        if step == 0:
            m[6] = m[7] = car.steer_gain * now[0] + car.steer_bias
            m[8] = _wheel_angle(car, s, m, t)
        _servo(car, m, _late(line, step, car.steer_delay, 0), held[step] > 0.0)
        angle = _wheel_angle(car, s, m, t)
        _steered(car, s, m, angle)
        accel = _motor(car, s, _late(line, step, car.drive_delay, 1), t, cut[step] > 0.0)
        _rk4(car, s, m, process[step], angle, accel, t, scratch)
        _remember(car, states[step], s, m, angle)


def simulate(
    car: PlantCar,
    start: Array,
    lead: int,
    orders: Orders,
    noise: Noise,
    change: tuple[int, PlantCar] | None = None,
) -> Trace:
    """Drive the car.

    Args:
        car: the car with whatever is wrong with it.
        start: x, y, yaw, speed at the beginning of the lead-in.
        lead: steps before the recording starts; time zero is its end.
        orders: commands, or a route, over lead-in and recording.
        noise: disturbances and pose errors of the same length.
        change: step from which on it is another car, and which.
    """
    n = len(noise.process)
    step, later = change or (n, car)
    s = np.zeros(10)
    s[:4] = start
    s[6:] = start[3]
    states, ticks = np.empty((n, 10)), n // TICK
    commands, poses = np.empty((ticks, 2)), np.empty((ticks, 3))
    _simulate(
        car, later, step, s, lead, orders.steer, orders.speed, orders.route, orders.route_accel,
        orders.held, orders.cut, noise.process, noise.pose, states, commands, poses,
    )  # fmt: skip
    return Trace(states, commands, poses)
