"""Where the mocap body sits on the car, the gain of the wheels and the delay of the poses.

Estimated from one slow drive. The centre of the rear axle has no lateral velocity but the tyres'
small slip. With the body's velocity (u_x, u_y) and yaw rate w in the car's axes (origin at the rear
axle, a left turn positive):

    u_y = r_x w - slip u_x^2 w         u_x = gain v_wheel / turned - r_y w

where a driven front axle rolls along its steered wheels, faster than the rear: with its share f of
the drive and the wheelbase L, turned = 1 - f + f hypot(1, L w / u_x). So two least squares give the
body's place (r_x, r_y), its heading error and the wheels' gain; the delay is the one at which poses
and wheels agree best while the speed changes. Pure.
"""

from dataclasses import dataclass
from functools import partial
from math import atan2, cos, degrees, hypot, sin
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from steerd.car_model.params import GRAVITY, Car, wheelbase
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.setup import calibration_data as data
from steerd.daemon.setup.calibration_data import Drive
from steerd.mocap_link.frame import FrameConfig
from steerd.sysid.data.data_checks import Array

RATE = 100.0  # sampling rate of the velocities [Hz]
WINDOW = 0.25  # window of the Savitzky-Golay filter that differentiates [s]
ORDER = 3  # its polynomial order
GAP = 0.1  # no velocity is taken across a longer gap between poses [s]
SLIP_PRIOR_SHARE = 0.5  # standard deviation of the slip's prior per the car file's value [-]
LATERAL_NOISE = 0.03
"""Noise of a lateral velocity, for the weight of that prior [m/s]: 6 mm/s, correlated over the 25
samples of `WINDOW`."""
SECONDS_MIN, TURN_MIN, SPEED_SPREAD_MIN = 5.0, 0.15, 0.1
"""Least motion [s], turning [rad/s, rms] and change of speed [m/s, rms] of a drive."""
GAIN_MIN, GAIN_MAX = 0.2, 5.0  # beyond these the wheels' gain is a wrong unit or another car [-]
GAIN_MODEL = 0.002
"""Standard error of the wheels' gain by the equations alone, as a share [-]: simulated drives."""
ITERATIONS = 4  # iterations of the heading, whose equation is linearised [-]


class Mount(NamedTuple):
    """Place of the mocap body on the car, gain of the wheels and delay of the poses."""

    yaw: float  # heading of the body's forward axis in the car [rad]
    rear_x: float  # the body's origin ahead of the rear axle [m]
    rear_y: float  # the same to the left [m]
    speed_gain: float  # true speed per reported one
    delay: float  # of the poses beyond their time stamps [s]


@dataclass(frozen=True)
class MountCalibration:
    """A mount with standard errors and warnings about the drive."""

    mount: Mount  # the values
    sd: Mount  # their standard errors
    seconds: float  # duration of the motion that was used
    warnings: tuple[str, ...]  # what the drive identifies badly, one sentence each
    residual: float  # of the lateral velocity [m/s, rms]


@dataclass(frozen=True)
class _Motion:
    """Body velocities on a uniform grid, in the room."""

    t: Array
    vx: Array
    vy: Array
    yaw: Array
    yaw_rate: Array
    good: data.Mask


def calibrate_mount(drive: Drive, car: Car[float], front: float = 0.0) -> MountCalibration:
    """Estimate the mount from a drive, with the car file's tyres and wheelbase.

    `front` is the front axle's share of the drive, see `steerd.car_model.planar.DRIVES`. A
    SteerdError where the car barely moves, never turns, or poses and wheels do not fit together.
    """
    motion = _differentiate(drive)
    slip = 1.0 / (car.mu * GRAVITY * car.c_sr)  # angle per acceleration, rear axle [rad s^2/m]
    moved = np.hypot(motion.vx, motion.vy)
    turn = wheelbase(car) * motion.yaw_rate / np.maximum(moved, data.MOVING)
    turned = 1.0 - front + front * np.hypot(1.0, turn)

    solve = partial(_solve, motion, drive, slip, turned)
    mount, residual = solve(motion.good)
    if not GAIN_MIN < mount.speed_gain < GAIN_MAX:
        what = f"the poses move {mount.speed_gain:.3g} times as far as the wheels say"
        hint = "check [mocap] units, [vesc] erpm_gain, and that this body is on this car"
        raise SteerdError(what, hint)
    sd = Mount(*data.jackknife_sd(motion.good, lambda keep: solve(keep)[0]))
    # What is common to all parts the jackknife does not show: the slip's uncertainty, the model's.
    rows = _lateral_rows(moved[motion.good], motion.yaw_rate[motion.good], slip)
    slip_sd = LATERAL_NOISE * float(np.sqrt(np.linalg.inv(rows.T @ rows)[0, 0]))
    sd = sd._replace(
        rear_x=float(np.hypot(sd.rear_x, slip_sd)),
        speed_gain=float(np.hypot(sd.speed_gain, GAIN_MODEL * mount.speed_gain)),
    )
    seconds = float(motion.good.sum()) / RATE
    return MountCalibration(mount, sd, seconds, tuple(_find_warnings(motion, drive)), residual)


def _differentiate(drive: Drive) -> _Motion:
    t = np.arange(drive.t[0], drive.t[-1], 1.0 / RATE)
    length = int(WINDOW * RATE) | 1
    if len(t) < 4 * length:
        raise SteerdError(f"the drive is {drive.t[-1] - drive.t[0]:.1f} s long: too short")
    smooth = {}
    for name, column in (("x", drive.x), ("y", drive.y), ("yaw", np.unwrap(drive.yaw))):
        even = np.interp(t, drive.t, column)
        smooth[name] = savgol_filter(even, length, ORDER)
        smooth[f"{name}'"] = savgol_filter(even, length, ORDER, deriv=1, delta=1.0 / RATE)
    after = np.clip(np.searchsorted(drive.t, t), 1, len(drive.t) - 1)
    whole = (drive.t[after] - drive.t[after - 1] < GAP).astype(float)
    whole = np.convolve(whole, np.ones(length), "same") > length - 0.5
    good = whole & (np.hypot(smooth["x'"], smooth["y'"]) > data.MOVING)
    seconds = good.sum() / RATE
    hint = "drive a minute below 1.5 m/s: straight on, and circles to both sides, at two speeds"
    if seconds < SECONDS_MIN:
        raise SteerdError(f"the car moves for {seconds:.1f} s: too little", hint)
    turning = float(np.sqrt(np.mean(smooth["yaw'"][good] ** 2)))
    if turning < TURN_MIN:
        raise SteerdError(f"the car turns with {turning:.2f} rad/s (rms): too little", hint)
    return _Motion(t, smooth["x'"], smooth["y'"], smooth["yaw"], smooth["yaw'"], good)


def _solve(
    m: _Motion, drive: Drive, slip: float, turned: Array, good: data.Mask
) -> tuple[Mount, float]:
    """The mount from some of the samples, and the residual of the lateral velocity."""
    w = m.yaw_rate[good]
    c, s = np.cos(m.yaw[good]), np.sin(m.yaw[good])
    bx = m.vx[good] * c + m.vy[good] * s
    by = m.vy[good] * c - m.vx[good] * s
    wheel = np.interp(m.t[good], drive.t_wheel, drive.wheel)
    ahead = np.sign(wheel) * (np.abs(wheel) > data.MOVING / 2)
    yaw = -atan2(float(np.sum(ahead * by)), float(np.sum(ahead * bx)))
    rear_x, residual = 0.0, 0.0
    for _ in range(ITERATIONS):
        ux, uy = cos(yaw) * bx - sin(yaw) * by, sin(yaw) * bx + cos(yaw) * by
        rows = _lateral_rows(ux, w, slip)
        (ahead_m, turn, _), left = data.solve_least_squares(rows, np.append(uy, rows[-1, 2] * slip))
        rear_x, residual = float(ahead_m), float(np.sqrt(np.mean(left[:-1] ** 2)))
        yaw += float(turn)
    ux = cos(yaw) * bx - sin(yaw) * by

    def forward(delay: float) -> tuple[Array, Array]:
        reported = np.interp(m.t[good] - delay, drive.t_wheel, drive.wheel)
        return data.solve_least_squares(np.column_stack([reported / turned[good], -w]), ux)

    delay = data.find_delay(lambda tau: float(np.sum(forward(tau)[1] ** 2)))
    gain, rear_y = forward(delay)[0]
    return Mount(yaw, rear_x, float(rear_y), float(gain), delay), residual


def _lateral_rows(ux: Array, w: Array, slip: float) -> Array:
    """Regressors of the lateral velocity: r_x, heading error, slip; the last row is its prior."""
    prior = [0.0, 0.0, LATERAL_NOISE / (SLIP_PRIOR_SHARE * slip)]
    return np.vstack([np.column_stack([w, -ux, -(ux**2) * w]), prior])


def _find_warnings(m: _Motion, drive: Drive) -> list[str]:
    warnings = []
    w = m.yaw_rate[m.good]
    if not (w.max() > TURN_MIN and w.min() < -TURN_MIN):
        warnings.append("it turns to one side only: drive circles to both sides")
    wheel = np.interp(m.t[m.good], drive.t_wheel, drive.wheel)
    if float(np.std(wheel)) < SPEED_SPREAD_MIN:
        warnings.append("its speed is almost constant, so the delay is uncertain: vary the speed")
    return [*warnings, *data.find_slip_warnings((m.yaw_rate * np.hypot(m.vx, m.vy))[m.good])]


def mount_values(found: MountCalibration, erpm_gain: float) -> dict[tuple[str, str], float]:
    """New values of the car file; a delay within two standard errors of zero becomes zero."""
    m, sd = found.mount, found.sd
    delay = m.delay if m.delay > 2.0 * sd.delay else 0.0
    return {
        ("mocap", "mount_yaw_deg"): round(degrees(m.yaw), 3),
        ("mocap", "marker_rear_x"): round(m.rear_x, 4),
        ("mocap", "marker_rear_y"): round(m.rear_y, 4),
        ("vesc", "erpm_gain"): round(erpm_gain / m.speed_gain, 1),
        ("car", "speed_gain"): 1.0,
        ("car", "pose_delay"): round(delay, 4),
    }


def describe_mount(found: MountCalibration, frame: FrameConfig, gain: float) -> list[str]:
    """What was found beside what the car file said, its ERPM per m/s with it, in lines."""
    m, sd = found.mount, found.sd
    moved = hypot(m.rear_x - frame.marker_rear_x, m.rear_y - frame.marker_rear_y)
    return [
        f"from {found.seconds:.0f} s of motion; lateral residual {1e3 * found.residual:.0f} mm/s",
        f"  heading of the body   {degrees(m.yaw):+z.3f}° ± {degrees(sd.yaw):.3f}°"
        f"   (was {degrees(frame.mount_yaw):+z.2f}°)",
        f"  ahead of rear axle    {1e3 * m.rear_x:+.1f} ± {1e3 * sd.rear_x:.1f} mm"
        f"   (was {1e3 * frame.marker_rear_x:+.1f})",
        f"  left of centre line   {1e3 * m.rear_y:+z.1f} ± {1e3 * sd.rear_y:.1f} mm"
        f"   (was {1e3 * frame.marker_rear_y:+.1f}; moved by {1e3 * moved:.0f} in all)",
        f"  ERPM per m/s          {gain / m.speed_gain:.0f} ± {gain * sd.speed_gain:.0f}"
        f"   (was {gain:.0f})",
        f"  delay of the poses    {1e3 * m.delay:+.1f} ± {1e3 * sd.delay:.1f} ms",
    ]
