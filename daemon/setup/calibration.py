"""From one slow drive: where the mocap body sits on the car, the wheels' gain, the poses' delay.

The centre of the rear axle has no lateral velocity but the tyre's small slip. With the body's
velocity (u_x, u_y) and yaw rate w in the car's axes (rear axle first, a left turn positive):

    u_y = r_x w - slip u_x^2 w         u_x = gain v_wheel - r_y w

so two least squares give the body's place (r_x, r_y), its heading error and the wheels' gain; the
delay is the one at which poses and wheels agree best while the speed changes. Pure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from math import atan2, cos, sin

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import savgol_filter

from steerd.car_model.params import GRAVITY, Car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.sessions.motion import Array

RATE = 100.0
"""Of the grid on which velocities are taken [Hz]."""
WINDOW = 0.25
"""Of the polynomial that is differentiated [s]."""
MOVING = 0.2
"""Slower motion is mostly noise [m/s]."""
GAP = 0.1
"""No velocity is taken across a longer gap between poses [s]."""
BLOCKS = 10
"""Contiguous parts left out in turn for the standard errors (delete-a-group jackknife)."""
DELAY_LOW, DELAY_HIGH = -0.05, 0.25
"""Where the delay is sought [s]."""
SLIP_DOUBT = 0.5
"""The car file's cornering stiffness is believed to this share."""
NOISE = 0.03
"""Of a lateral velocity, for the weight of that belief: 6 mm/s, and neighbours within `WINDOW`, 25
samples, are one [m/s]."""
SECONDS_MIN, TURN_MIN, SPEED_SPREAD_MIN = 5.0, 0.15, 0.1
"""A drive must move so long [s], turn so much [rad/s, rms], change its speed so much [m/s, rms]."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Drive:
    """Body poses in the room (no offsets applied) and wheel speed; times in seconds.

    Attributes:
        t, x, y, yaw: of the body's origin and forward axis [s, m, m, rad].
        t_wheel, wheel: reported speed [s, m/s].
    """

    t: Array
    x: Array
    y: Array
    yaw: Array
    t_wheel: Array
    wheel: Array


@dataclass(frozen=True)
class Mount:
    """What a drive tells.

    Attributes:
        yaw: heading of the body's forward axis in the car [rad].
        rear_x, rear_y: the body's origin ahead of the rear axle and to the left [m].
        speed_gain: true speed per reported one.
        delay: of the poses beyond their time stamps [s].
    """

    yaw: float
    rear_x: float
    rear_y: float
    speed_gain: float
    delay: float


@dataclass(frozen=True)
class Calibration:
    """A mount with standard errors and what the drive was good for.

    Attributes:
        mount: the values.
        sd: their standard errors.
        seconds: of motion that was used.
        doubts: what the drive cannot tell well, one sentence each.
        residual: of the lateral velocity [m/s, rms].
    """

    mount: Mount
    sd: Mount
    seconds: float
    doubts: tuple[str, ...]
    residual: float


@dataclass(frozen=True)
class _Motion:
    """Body velocities on a uniform grid, in the room."""

    t: Array
    vx: Array
    vy: Array
    yaw: Array
    yaw_rate: Array
    good: Mask


def slip_per_accel(car: Car[float]) -> float:
    """Slip angle of the rear axle per lateral acceleration [rad s^2/m]: 1 / (mu g C_Sr)."""
    return 1.0 / (car.mu * GRAVITY * car.c_sr)


def calibrate_mount(drive: Drive, car: Car[float]) -> Calibration:
    """Find the mount from a drive.

    Raises:
        SteerdError: it hardly moves, never turns, or poses and wheels do not belong together.
    """
    motion = _differentiate(drive)
    _expect_motion(motion)
    slip = slip_per_accel(car)
    mount, residual = _solve(motion, drive, slip, motion.good)
    if not 0.2 < mount.speed_gain < 5.0:
        what = f"the poses move {mount.speed_gain:.3g} times as far as the wheels say"
        hint = "check [mocap] units, [vesc] erpm_gain, and that this body is on this car"
        raise SteerdError(what, hint)
    parts = [_solve(motion, drive, slip, keep)[0] for keep in _leave_out(motion.good)]
    names = [f.name for f in fields(Mount)]
    rows = [np.array([getattr(part, name) for name in names]) for part in parts]
    sd = dict(zip(names, _jackknife(rows), strict=True))
    # What the slip leaves open is the same in every part, so the parts do not show it.
    sd["rear_x"] = float(np.hypot(sd["rear_x"], _open_by_slip(motion, slip)))
    seconds = float(motion.good.sum()) / RATE
    doubts = tuple(_doubts(motion, drive))
    return Calibration(mount, Mount(**sd), seconds, doubts, residual)


def _differentiate(drive: Drive) -> _Motion:
    t = np.arange(drive.t[0], drive.t[-1], 1.0 / RATE)
    length = int(WINDOW * RATE) | 1
    if len(t) < 4 * length:
        raise SteerdError(f"the drive is {drive.t[-1] - drive.t[0]:.1f} s long: too short")
    smooth = {}
    for name, column in (("x", drive.x), ("y", drive.y), ("yaw", np.unwrap(drive.yaw))):
        even = np.interp(t, drive.t, column)
        smooth[name] = savgol_filter(even, length, 3)
        smooth[f"{name}'"] = savgol_filter(even, length, 3, deriv=1, delta=1.0 / RATE)
    after = np.clip(np.searchsorted(drive.t, t), 1, len(drive.t) - 1)
    whole = (drive.t[after] - drive.t[after - 1] < GAP).astype(float)
    whole = np.convolve(whole, np.ones(length), "same") > length - 0.5
    fast = np.hypot(smooth["x'"], smooth["y'"]) > MOVING
    return _Motion(t, smooth["x'"], smooth["y'"], smooth["yaw"], smooth["yaw'"], whole & fast)


def _expect_motion(motion: _Motion) -> None:
    seconds = motion.good.sum() / RATE
    hint = "drive a minute below 1.5 m/s: straight on, and circles to both sides, at two speeds"
    if seconds < SECONDS_MIN:
        raise SteerdError(f"the car moves for {seconds:.1f} s: too little", hint)
    turning = float(np.sqrt(np.mean(motion.yaw_rate[motion.good] ** 2)))
    if turning < TURN_MIN:
        raise SteerdError(f"the car turns with {turning:.2f} rad/s (rms): too little", hint)


def _leave_out(good: Mask) -> list[Mask]:
    """The good samples without each of ten contiguous parts."""
    parts = np.array_split(np.flatnonzero(good), BLOCKS)
    masks = []
    for part in parts:
        mask = good.copy()
        mask[part] = False
        masks.append(mask)
    return masks


def _solve(m: _Motion, drive: Drive, slip: float, good: Mask) -> tuple[Mount, float]:
    """The mount from some of the samples, and the residual of the lateral velocity."""
    w = m.yaw_rate[good]
    c, s = np.cos(m.yaw[good]), np.sin(m.yaw[good])
    bx = m.vx[good] * c + m.vy[good] * s
    by = m.vy[good] * c - m.vx[good] * s
    wheel = np.interp(m.t[good], drive.t_wheel, drive.wheel)
    ahead = np.sign(wheel) * (np.abs(wheel) > MOVING / 2)
    yaw = -atan2(float(np.sum(ahead * by)), float(np.sum(ahead * bx)))
    rear_x, residual = 0.0, 0.0
    for _ in range(4):
        ux, uy = cos(yaw) * bx - sin(yaw) * by, sin(yaw) * bx + cos(yaw) * by
        turn, rear_x, residual = _lateral(ux, uy, w, slip)
        yaw += turn
    ux = cos(yaw) * bx - sin(yaw) * by

    def forward(delay: float) -> tuple[Array, Array]:
        reported = np.interp(m.t[good] - delay, drive.t_wheel, drive.wheel)
        return _least(np.column_stack([reported, -w]), ux)

    delay = _best(lambda tau: float(np.sum(forward(tau)[1] ** 2)))
    gain, rear_y = forward(delay)[0]
    return Mount(yaw, rear_x, float(rear_y), float(gain), delay), residual


def _lateral(ux: Array, uy: Array, w: Array, slip: float) -> tuple[float, float, float]:
    """Heading error still left [rad], r_x [m], residual [m/s].

    The slip's prior is one more row: its value, weighed by the share to which it is believed.
    """
    rows = np.column_stack([w, -ux, -(ux**2) * w])
    belief = NOISE / (SLIP_DOUBT * slip)
    rows = np.vstack([rows, [0.0, 0.0, belief]])
    (rear_x, turn, _), left = _least(rows, np.append(uy, belief * slip))
    return float(turn), float(rear_x), float(np.sqrt(np.mean(left[:-1] ** 2)))


def _open_by_slip(m: _Motion, slip: float) -> float:
    """Standard error of r_x that comes with the belief in the slip [m]."""
    speed, w = np.hypot(m.vx, m.vy)[m.good], m.yaw_rate[m.good]
    rows = np.column_stack([w, -speed, -(speed**2) * w])
    rows = np.vstack([rows, [0.0, 0.0, NOISE / (SLIP_DOUBT * slip)]])
    return NOISE * float(np.sqrt(np.linalg.inv(rows.T @ rows)[0, 0]))


def _least(rows: Array, values: Array) -> tuple[Array, Array]:
    solution = np.linalg.lstsq(rows, values, rcond=None)[0]
    return np.asarray(solution, dtype=np.float64), values - rows @ solution


def _best(cost: Callable[[float], float]) -> float:
    """The delay of least cost: the best of a grid, refined."""
    grid = np.arange(DELAY_LOW, DELAY_HIGH, 0.01)
    at = float(grid[int(np.argmin([cost(float(tau)) for tau in grid]))])
    found = minimize_scalar(cost, bounds=(at - 0.01, at + 0.01), method="bounded")
    return float(found.x)


def _doubts(m: _Motion, drive: Drive) -> list[str]:
    doubts = []
    w = m.yaw_rate[m.good]
    if not (w.max() > TURN_MIN and w.min() < -TURN_MIN):
        doubts.append("it turns to one side only: drive circles to both sides")
    wheel = np.interp(m.t[m.good], drive.t_wheel, drive.wheel)
    if float(np.std(wheel)) < SPEED_SPREAD_MIN:
        doubts.append("its speed hardly changes, so the delay is uncertain: vary the speed")
    return [*doubts, *_slip_doubts((m.yaw_rate * np.hypot(m.vx, m.vy))[m.good])]


def _slip_doubts(lateral: Array) -> list[str]:
    """Doubts of a drive with these lateral accelerations [m/s^2]."""
    if float(np.quantile(np.abs(lateral), 0.95)) <= 2.0:
        return []
    return ["it corners with more than 2 m/s²: tyre slip blurs the result, drive slower"]


# -- steering ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Steering:
    """How the wheels follow the commands of a drive.

    Attributes:
        gain: wheel angle per commanded angle.
        bias: wheel angle at command zero [rad].
        delay: from command to wheel, lag included [s].
        left, right: largest angles that the wheels reached [rad]; right is negative.
        clipped_left, clipped_right: whether commands beyond them had no effect.
        residual: [rad, rms].
        sd_gain, sd_bias: standard errors.
        doubts: what the drive cannot tell well, one sentence each.
    """

    gain: float
    bias: float
    delay: float
    left: float
    right: float
    clipped_left: bool
    clipped_right: bool
    residual: float
    sd_gain: float
    sd_bias: float
    doubts: tuple[str, ...]


STEADY_BEFORE, STEADY_AFTER = 0.25, 0.15
"""The command's course about a sample that counts: the servo's lag before it, what the velocities
were differentiated over behind it [s]."""
STEADY = 0.02
"""Over that time the command keeps so near to a straight line where one delay explains the wheels;
a step has one angle asked for and another one reached [rad]."""
SD_GAIN_MAX = 0.05
"""A gain that is known no better is none to drive with."""
_EIGHT = "drive a figure of eight"
CLIP = 0.035
"""Wheels that stay so far behind the commands at their ends have met a stop [rad]."""


def calibrate_steering(
    t: Array, speed: Array, yaw_rate: Array, t_command: Array, command: Array, car: Car[float]
) -> Steering:
    """Find gain and centre of the steering from commands and the turning that they gave.

    The wheel angle that a steady turn needs is atan(L curvature) plus the difference of the axles'
    slip, curvature v^2 (alpha_f - alpha_r per acceleration), after the car file's tyres.

    Args:
        t: times of the motion [s].
        speed: of the car [m/s].
        yaw_rate: of the car [rad/s].
        t_command: times of the orders [s].
        command: steering angles ordered [rad].
        car: geometry and tyres.

    Raises:
        SteerdError: the car hardly moves, or its steering is hardly used.
    """
    good = np.isfinite(speed) & np.isfinite(yaw_rate) & (speed > MOVING)
    if good.sum() < 200:
        raise SteerdError("the car hardly moves forward: nothing to learn of its steering")
    t, v, w = t[good], speed[good], yaw_rate[good]
    length = car.lf + car.lr
    slip = (1.0 / car.c_sf - 1.0 / car.c_sr) / (car.mu * GRAVITY)
    angle = np.arctan(length * w / v) + slip * v * w
    now = np.interp(t, t_command, command)
    low, high = now.min(), now.max()
    steady = _steady(t, t_command, command)
    _check_steering(now, steady)

    def fit(delay: float, keep: Mask = steady) -> tuple[Array, Array, Array]:
        asked = np.interp(t - delay, t_command, command)
        # The outer quarters may lie beyond a stop, unless nothing else was driven.
        inner = keep & (np.abs(asked - (low + high) / 2) <= (high - low) / 4)
        used = inner if np.std(asked[inner]) > 0.1 * (high - low) else keep
        rows = np.column_stack([asked[used], np.ones(used.sum())])
        return (*_least(rows, angle[used]), asked)

    delay = _best(lambda tau: float(np.mean(fit(tau)[1] ** 2)))
    (gain, bias), left, asked = fit(delay)
    sd_gain, sd_bias = _jackknife([fit(delay, part)[0] for part in _leave_out(steady)])
    _check_gain(float(gain), sd_gain)
    ends = [_end(angle, gain * asked + bias, side) for side in (1.0, -1.0)]
    return Steering(
        gain=float(gain),
        bias=float(bias),
        delay=delay,
        left=ends[0][0],
        right=-ends[1][0],
        clipped_left=ends[0][1],
        clipped_right=ends[1][1],
        residual=float(np.sqrt(np.mean(left**2))),
        sd_gain=sd_gain,
        sd_bias=sd_bias,
        doubts=tuple(_slip_doubts(v * w)),
    )


def _check_steering(asked: Array, steady: Mask) -> None:
    if np.std(asked) < 0.02:
        raise SteerdError("the steering is hardly used in this drive", _EIGHT)
    if steady.sum() < 200:
        raise SteerdError("the steering swings too fast for the car to follow", _EIGHT)


def _check_gain(gain: float, sd: float) -> None:
    if gain < 0.1:
        what = f"the car turns {gain:+.2f} times what was asked for"
        hint = "a negative figure: change the sign of [vesc] servo_gain; else see `steerd probe`"
        raise SteerdError(what, hint, ExitCode.INVALID)
    if sd > SD_GAIN_MAX:
        what = f"this drive tells the steering gain to ±{sd:.2f} only"
        raise SteerdError(what, f"{_EIGHT}, slowly", ExitCode.STOPPED)


def _steady(t: Array, t_command: Array, command: Array) -> Mask:
    """Where the command neither steps nor swings, so that the wheels can have followed it."""
    offsets = np.arange(-STEADY_BEFORE, STEADY_AFTER, 0.02)
    around = np.stack([np.interp(t + dt, t_command, command) for dt in offsets])
    share = ((offsets - offsets[0]) / np.ptp(offsets))[:, None]
    line = (1.0 - share) * around[0] + share * around[-1]
    return np.asarray(np.abs(around - line).max(axis=0) < STEADY, dtype=np.bool_)


def _jackknife(parts: Sequence[Array]) -> tuple[float, ...]:
    """Standard errors of values from what they are without each part in turn."""
    values = np.array(parts)
    spread = np.sum((values - values.mean(axis=0)) ** 2, axis=0)
    return tuple(np.sqrt((len(parts) - 1) / len(parts) * spread).tolist())


def _end(angle: Array, predicted: Array, side: float) -> tuple[float, bool]:
    """The angle reached on one side, and whether the wheels stayed behind the commands there."""
    reached, aim = side * angle, side * predicted
    outer = aim >= np.quantile(aim, 0.95)
    behind = float(np.median(aim[outer] - reached[outer]))
    top = float(np.median(reached[outer])) if behind > CLIP else float(np.quantile(reached, 0.99))
    return top, behind > CLIP
