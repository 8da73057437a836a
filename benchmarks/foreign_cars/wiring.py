"""What lies between a command and the wheels, and between the car and the log, in plants b and c.

Command line, servo, linkage and motor controller of a 1:10 car, and a mocap system that looks at
it. Written for these plants alone, on a grid of one millisecond.
"""

from math import exp
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.blind_gap.drives import LEAD, make_noise, make_spells
from benchmarks.blind_gap.plant import STEP, TICK
from benchmarks.foreign_cars.drives import LEAD_TICKS, Commands
from benchmarks.foreign_cars.log import Log

Array = NDArray[np.float64]

_WHEEL_SD = 0.01
"""Noise of the measured wheel speed [m/s]."""


class Wiring(NamedTuple):
    """Numbers of the actuators and sensors, SI units; healthy cars draw some of them.

    Slew limit, end stops and current limits are those of the car class's published file.
    """

    steer_gain: float = 1.0
    steer_bias: float = 0.0
    steer_delay: float = 0.01
    steer_lag: float = 0.05
    steer_rate: float = 3.2
    steer_left: float = 0.34
    steer_right: float = 0.34
    steer_play: float = 0.0
    steer_cubic: float = 0.0
    """Wheel angle added per cube of the servo's angle [1/rad^2]."""
    steer_asymmetry: float = 0.0
    steer_grid: float = 0.0
    """Grid on which the servo reads its command [rad]."""
    speed_gain: float = 1.0
    """True rolling speed per speed that the motor controller believes."""
    drive_delay: float = 0.0
    drive_lag: float = 0.10
    accel_max: float = 5.0
    brake_max: float = 5.0
    sag_rate: float = 0.0
    """Speed lost per minute [1/min]."""
    pose_delay: float = 0.0
    marker_x: float = 0.0
    marker_y: float = 0.0
    marker_yaw: float = 0.0
    swim: float = 0.0
    """Amplitude of a slow movement of the mocap frame [m]."""
    stamp_jitter: float = 0.0
    """Standard deviation of the poses' stamps [s]."""
    freeze: float = 0.0
    """Length of the servo's freezes [s]."""
    cut: float = 0.0
    """Length of the motor's drop-outs [s]."""


class Orders(NamedTuple):
    """What reaches the actuators, each millisecond: angle after the linkage [rad], rolling speed
    aimed at [m/s], 1 where the motor is cut off."""

    angle: Array
    speed: Array
    cut: Array


class Push(NamedTuple):
    """Disturbances: accelerations along x, y and yaw per step, and pose errors per tick."""

    process: Array
    pose: Array


def draw_wiring(rng: np.random.Generator) -> Wiring:
    """A healthy car's wiring."""
    return Wiring(
        steer_gain=float(rng.uniform(0.95, 1.05)),
        steer_bias=float(rng.uniform(-0.02, 0.02)),
        steer_delay=float(rng.uniform(0.008, 0.02)),
        steer_lag=float(rng.uniform(0.045, 0.055)),
        speed_gain=float(rng.uniform(0.96, 1.04)),
        drive_lag=float(rng.uniform(0.09, 0.11)),
    )


def make_push(commands: Commands, rng: np.random.Generator) -> Push:
    """Coloured pushes on the car and white pose errors, as in the blind test."""
    noise = make_noise((commands.steps - LEAD) * STEP, rng, process_scale=commands.push)
    return Push(noise.process, noise.pose)


def _held(values: Array, steps: int, delay: float) -> Array:
    """Values at 100 Hz, held, `delay` seconds late, each millisecond."""
    at = np.maximum(np.arange(steps) - round(delay / STEP), 0) // TICK
    return np.asarray(values[at])


@njit(cache=True)
def _servo(aim: Array, held: Array, lag: float, rate: float, play: float) -> Array:
    """Servo with lag and slew limit, linkage with play, started at rest on the first aim."""
    out, angle, behind = np.empty(len(aim)), aim[0], aim[0]
    share = 1.0 - exp(-STEP / max(lag, 1e-5))
    for i in range(len(aim)):
        if held[i] == 0.0:
            angle += min(max(share * (aim[i] - angle), -rate * STEP), rate * STEP)
        behind = min(max(behind, angle - 0.5 * play), angle + 0.5 * play)
        out[i] = behind
    return out


def make_orders(wiring: Wiring, commands: Commands, rng: np.random.Generator) -> Orders:
    """What reaches the actuators under these commands.

    Args:
        wiring: the car's.
        commands: at 100 Hz, lead-in included.
        rng: when servo and motor fail, if they do.
    """
    w, n = wiring, commands.steps
    seconds = (n - LEAD) * STEP
    held = make_spells(seconds, w.freeze, 1.5, rng)
    cut = make_spells(seconds, w.cut, 3.0, rng)
    late = _held(commands.steer, n, w.steer_delay)
    if w.steer_grid > 0.0:
        late = w.steer_grid * np.round(late / w.steer_grid)
    aim = np.clip(w.steer_gain * late + w.steer_bias, -w.steer_right, w.steer_left)
    angle = _servo(aim, held, w.steer_lag, w.steer_rate, w.steer_play)
    angle = angle + w.steer_asymmetry * np.abs(angle) + w.steer_cubic * angle**3
    since_start = np.maximum(np.arange(n) - LEAD, 0) * STEP
    sag = np.exp(-w.sag_rate * since_start / 60.0)
    speed = w.speed_gain * sag * _held(commands.speed, n, w.drive_delay)
    return Orders(angle, speed, cut)


def observe(
    wiring: Wiring,
    commands: Commands,
    path: Array,
    rolling: Array,
    pose_noise: Array,
    rng: np.random.Generator,
) -> Log:
    """What the log holds of a drive.

    Args:
        wiring: what mocap and wheel speed are like.
        commands: wheel angle and speed at 100 Hz.
        path: x, y, yaw (continuous) of the tracked body each millisecond, lead-in included.
        rolling: surface speed of the driven wheels each millisecond [m/s].
        pose_noise: pose errors per tick, lead-in included.
        rng: errors of wheel speed and stamps.
    """
    w = wiring
    ticks = np.arange(LEAD_TICKS, len(commands.steer))
    at = np.maximum(ticks * TICK - w.pose_delay / STEP, 0.0)
    steps = np.arange(len(path))
    x, y, yaw = (np.interp(at, steps, column) for column in path.T)
    t = (ticks - LEAD_TICKS) * TICK * STEP
    seen = np.column_stack([
        x + np.cos(yaw) * w.marker_x - np.sin(yaw) * w.marker_y + w.swim * np.sin(0.9 * t),
        y + np.sin(yaw) * w.marker_x + np.cos(yaw) * w.marker_y + w.swim * np.cos(0.65 * t),
        yaw + w.marker_yaw,
    ])  # fmt: skip
    stamps = np.sort(t + w.stamp_jitter * rng.standard_normal(len(t)))
    wheel = rolling[ticks * TICK] / w.speed_gain + _WHEEL_SD * rng.standard_normal(len(t))
    sent = np.column_stack([commands.steer, commands.speed])[ticks]
    return Log(stamps - min(stamps[0], 0.0), seen + pose_noise[ticks], sent, wheel)
