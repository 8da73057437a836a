"""Gain, centre, delay and limits of the steering, from its commands and the turning. Pure."""

from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from steerd.car_model.params import GRAVITY, Car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.sessions.motion import Track
from steerd.daemon.setup import calibration_data as data
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Signal
from steerd.vesc_link.scaling import Scaling

STEADY_BEFORE, STEADY_AFTER, STEADY_STEP = 0.25, 0.15, 0.02
"""Stretch about a sample over which its command must be steady [s]: the servo's lag before it, half
the window of the differentiation after it; and the spacing of the instants looked at [s]."""
STEADY = 0.02
"""Largest distance of a steady command from a straight line over that stretch [rad]: then one delay
describes the wheels, also on a ramp."""
SAMPLES_MIN = 200  # fewer samples, two seconds of them, identify nothing
STEER_SD_MIN = 0.02  # commands that vary less do not excite the steering [rad]
GAIN_MIN = 0.1  # a smaller gain is a wrong sign or a servo that does not follow [-]
SD_GAIN_MAX = 0.05  # largest standard error of a gain that may be driven with [-]
CLIP = 0.035  # wheels that stay this far behind the largest commands have reached a stop [rad]
_EIGHT = "drive a figure of eight"


@dataclass(frozen=True)
class SteeringCalibration:
    """How the wheels follow the commands of a drive."""

    gain: float  # wheel angle per commanded angle
    bias: float  # wheel angle at command zero [rad]
    delay: float  # from command to wheel, lag included [s]
    left: float  # largest angles that the wheels reached [rad]; right is negative
    right: float
    clipped_left: bool  # whether commands beyond them had no effect
    clipped_right: bool
    sd_gain: float  # standard errors
    sd_bias: float
    warnings: tuple[str, ...]  # what the drive identifies badly, one sentence each


def calibrate_steering(track: Track, steer: Signal, car: Car[float]) -> SteeringCalibration:
    """Estimate gain and centre of the steering from commands [rad] and the turning that followed.

    The wheel angle that a steady turn needs is atan(L curvature) plus the difference of the axles'
    slip, curvature v^2 (alpha_f - alpha_r per acceleration), after the car file's tyres. A
    SteerdError where the car barely moves, or its steering is barely used.
    """
    good = np.isfinite(track.speed) & np.isfinite(track.yaw_rate) & (track.speed > data.MOVING)
    if good.sum() < SAMPLES_MIN:
        raise SteerdError("the car barely moves forward: its steering is not identifiable")
    t, v, w = track.t[good], track.speed[good], track.yaw_rate[good]
    length = car.lf + car.lr
    slip = (1.0 / car.c_sf - 1.0 / car.c_sr) / (car.mu * GRAVITY)
    angle = np.arctan(length * w / v) + slip * v * w
    now = np.interp(t, steer.t, steer.values)
    low, high = now.min(), now.max()
    steady = _find_steady(t, steer)
    if np.std(now) < STEER_SD_MIN:
        raise SteerdError("the steering is barely used in this drive", _EIGHT)
    if steady.sum() < SAMPLES_MIN:
        raise SteerdError("the steering swings too fast for the car to follow", _EIGHT)

    def fit(delay: float, keep: data.Mask = steady) -> tuple[Array, Array, Array]:
        commanded = np.interp(t - delay, steer.t, steer.values)
        # The outer quarters may lie beyond a stop, unless nothing else was driven.
        inner = keep & (np.abs(commanded - (low + high) / 2) <= (high - low) / 4)
        used = inner if np.std(commanded[inner]) > 0.1 * (high - low) else keep
        rows = np.column_stack([commanded[used], np.ones(used.sum())])
        return (*data.solve_least_squares(rows, angle[used]), commanded)

    delay = data.find_delay(lambda tau: float(np.mean(fit(tau)[1] ** 2)))
    (gain, bias), _, commanded = fit(delay)
    sd_gain, sd_bias = data.jackknife_sd(steady, lambda keep: fit(delay, keep)[0])
    if gain < GAIN_MIN:
        what = f"the car turns {gain:+.2f} times as much as commanded"
        hint = "if negative, change the sign of [vesc] servo_gain, else see `steerd probe`"
        raise SteerdError(what, hint, ExitCode.INVALID)
    if sd_gain > SD_GAIN_MAX:
        what = f"the steering gain is identified to ±{sd_gain:.2f} only"
        raise SteerdError(what, f"{_EIGHT}, slowly", ExitCode.STOPPED)
    left, clipped_left = _find_end(angle, gain * commanded + bias, 1.0)
    right, clipped_right = _find_end(angle, gain * commanded + bias, -1.0)
    return SteeringCalibration(
        float(gain), float(bias), delay, left, -right, clipped_left, clipped_right,
        sd_gain, sd_bias, tuple(data.find_slip_warnings(v * w)),
    )  # fmt: skip


def _find_steady(t: Array, steer: Signal) -> data.Mask:
    """Where the command is steady enough for the wheels to have followed it."""
    offsets = np.arange(-STEADY_BEFORE, STEADY_AFTER, STEADY_STEP)
    around = np.stack([np.interp(t + dt, steer.t, steer.values) for dt in offsets])
    share = ((offsets - offsets[0]) / np.ptp(offsets))[:, None]
    line = (1.0 - share) * around[0] + share * around[-1]
    return np.asarray(np.abs(around - line).max(axis=0) < STEADY, dtype=np.bool_)


def _find_end(angle: Array, predicted: Array, side: float) -> tuple[float, bool]:
    """The largest angle on one side, and whether the wheels stayed behind the commands there."""
    reached, aim = side * angle, side * predicted
    outer = aim >= np.quantile(aim, 0.95)
    behind = float(np.median(aim[outer] - reached[outer]))
    top = float(np.median(reached[outer])) if behind > CLIP else float(np.quantile(reached, 0.99))
    return top, behind > CLIP


def servo_scaling(found: SteeringCalibration, old: Scaling) -> Scaling:
    """Servo gain and centre for the wheels' angle; limits move inwards only, to the stops."""
    gain = old.servo_gain / found.gain
    offset = old.servo_offset - gain * found.bias
    low, high = old.servo_min, old.servo_max
    for angle, clipped in ((found.left, found.clipped_left), (found.right, found.clipped_right)):
        position = gain * angle + offset
        if clipped and position < offset:
            low = max(low, position)
        elif clipped:
            high = min(high, position)
    return replace(old, servo_gain=gain, servo_offset=offset, servo_min=low, servo_max=high)


def describe_steering(found: SteeringCalibration, scaling: Scaling) -> list[str]:
    """What was found, and the servo's new scaling, in lines."""
    stops = {True: "a stop", False: "no stop reached"}
    return [
        f"wheel angle = {found.gain:.3f} ± {found.sd_gain:.3f} × command "
        f"{degrees(found.bias):+z.2f}° ± {degrees(found.sd_bias):.2f}°",
        f"delay {1e3 * found.delay:.0f} ms, lag included",
        f"reached {degrees(found.left):.1f}° left ({stops[found.clipped_left]}), "
        f"{degrees(-found.right):.1f}° right ({stops[found.clipped_right]})",
        f"servo: gain {scaling.servo_gain:.4f} per rad, centre {scaling.servo_offset:.4f}, "
        f"from {scaling.servo_min:.3f} to {scaling.servo_max:.3f}",
    ]
