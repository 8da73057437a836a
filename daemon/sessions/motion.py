"""The motion of a recorded car, and checks of units, signs and axes.

Speed and yaw rate are differences of poses over a window whose length follows from the noise of
the poses. All functions are linear in the number of samples.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus.topic_columns import Columns
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Signal, pose_slopes

WINDOW, WINDOW_MAX = 0.2, 1.0
"""Span of the differences [s]: the shorter for mocap, up to the longer for coarse poses."""
_SPEED_NOISE = 0.05  # standard deviation of the speed that the window allows [m/s]
GAP_MAX = 0.5  # no motion is interpolated across a longer gap between poses [s]
COORDINATE_MAX = 1e9  # larger coordinates are damage, not places [m]
MOVING = 0.05  # below this a car counts as standing [m/s]
_DRIVING = 0.3  # ratios of speeds are formed above this [m/s]
_TURNING = 0.1  # the gyro is compared above this yaw rate [rad/s, rms]
_SHARE = 0.95  # a car that moves backwards for this share of its samples does so throughout
_SAMPLES_MIN = 10  # fewer samples decide nothing
_EXTENT_MAX, _SPEED_MAX = 100.0, 20.0  # a larger room [m] at a higher speed [m/s] is a wrong unit
_STEP = 0.05  # directions of the path are taken over this distance [m]
_STEPS_MAX = 10_000
_RATIO_LOW, _RATIO_HIGH = 0.8, 1.25  # wheel speed over path speed within these is plausible [-]
_ERPM_LEFT = 0.3  # share of the electrical rpm that a gain must leave unexplained at most [-]
_STEER_LATENCY = 0.15  # delay and lag of an ordinary car's steering [s]


@dataclass(frozen=True, slots=True)
class Track:
    """Poses over time, with speed and yaw rate; arrays of shape (n,), times increasing."""

    t: Array
    x: Array
    y: Array
    yaw: Array  # as recorded, unwrapped [rad]
    speed: Array  # along the body's axis; NaN where gaps are everywhere [m/s]
    yaw_rate: Array
    window: float  # span of the differences that gave speed and yaw rate [s]

    @property
    def coarse(self) -> bool:
        """Whether the poses are too noisy to give speed by themselves."""
        return self.window > WINDOW

    @property
    def lateral_accel(self) -> Array:
        """Centripetal acceleration [m/s²]."""
        return self.speed * self.yaw_rate

    @property
    def length(self) -> float:
        """Distance driven, without standstill [m]."""
        speed = np.abs(np.nan_to_num(self.speed))
        steps = np.minimum(np.diff(self.t), GAP_MAX)
        return float(np.sum(np.where(speed > MOVING, speed, 0.0)[:-1] * steps))


@dataclass(frozen=True, slots=True)
class SignalRange:
    """A signal's 0.1 % and 99.9 % quantiles and its standard deviation."""

    low: float
    high: float
    sd: float


def make_track(t: Array, x: Array, y: Array, yaw: Array) -> Track | None:
    """Make a track of poses; None for fewer than three usable ones."""
    good = np.isfinite(t) & np.isfinite(x) & np.isfinite(y) & np.isfinite(yaw)
    good &= (np.maximum(np.abs(x), np.abs(y)) < COORDINATE_MAX) & (np.abs(yaw) < COORDINATE_MAX)
    t, x, y, yaw = t[good], x[good], y[good], yaw[good]
    order = np.argsort(t, kind="stable")
    order = order[np.diff(t[order], prepend=-np.inf) > 0]
    if len(order) < 3:
        return None
    t, x, y, yaw = t[order], x[order], y[order], np.unwrap(yaw[order])
    # White noise of deviation s has second differences of deviation sqrt(6) s, and a difference
    # over a window w has sqrt(2) s / w.
    power = float(np.mean(np.diff(x, 2) ** 2 + np.diff(y, 2) ** 2)) / 2.0
    window = min(max(sqrt(power / 3.0) / _SPEED_NOISE, WINDOW), WINDOW_MAX)
    at, slopes = pose_slopes(Signal(t, np.column_stack([x, y, yaw])), window)
    gaps = np.cumsum(np.diff(t, prepend=t[0]) > GAP_MAX)
    whole = gaps[len(t) - len(at) :] == gaps[: len(at)]
    at, slopes = (at[whole], slopes[whole]) if whole.any() else (at, np.nan * slopes)
    vx, vy, yaw_rate = (np.interp(t, at, slope) for slope in slopes.T)
    forward = vx * np.cos(yaw) + vy * np.sin(yaw)
    return Track(t, x, y, yaw, np.copysign(np.hypot(vx, vy), forward), yaw_rate, window)


def make_range(values: Array) -> SignalRange | None:
    """The range of the finite values; None if there is none."""
    values = values[np.isfinite(values)]
    if not values.size:
        return None
    low, high = np.quantile(values, (0.001, 0.999))
    return SignalRange(float(low), float(high), float(np.std(values)))


# -- plausibility --------------------------------------------------------------------------------


def find_erpm_gain(track: Track | None, erpm: Signal | None) -> float | None:
    """Electrical rpm per m/s that the poses show, sign included; None where they cannot say."""
    found = None if track is None or erpm is None else _while_driven(track, erpm)
    if found is None:
        return None
    speed, _, value = found
    gain = float(np.sum(speed * value) / np.sum(speed**2))
    left = float(np.sqrt(np.mean((value - gain * speed) ** 2) / np.mean(value**2)))
    return gain if left < _ERPM_LEFT and abs(gain) >= 1.0 else None


def _while_driven(track: Track, signal: Signal, later: float = 0.0) -> tuple[Array, ...] | None:
    """Speed and yaw rate of the poses, so much later [s], and the signal; None of too few."""
    poses = (np.nan_to_num(track.speed), np.nan_to_num(track.yaw_rate))
    speed, rate = (np.interp(signal.t + later, track.t, each, np.nan, np.nan) for each in poses)
    both = np.isfinite(speed) & np.isfinite(signal.values) & (np.abs(speed) > _DRIVING)
    if np.count_nonzero(both) < _SAMPLES_MIN:
        return None
    return speed[both], rate[both], signal.values[both]


def check_erpm(track: Track | None, erpm: Signal | None, stated: float) -> list[str]:
    """Whether poses and electrical rpm belong together as was stated or assumed."""
    gain = find_erpm_gain(track, erpm)
    if gain is None or _RATIO_LOW <= gain / stated <= _RATIO_HIGH:
        return []
    shown = round_gain(gain)
    return [
        f"the poses show {shown:.0f} ERPM per m/s, and {stated:.0f} was assumed: a motor that is "
        f"wired or geared otherwise? Import it with --erpm-gain {shown:.0f}"
    ]


def round_gain(gain: float) -> float:
    """Two digits and a half: poses say no more."""
    unit = 10.0 ** (np.floor(np.log10(abs(gain))) - 1.0) / 2.0
    return float(np.round(gain / unit) * unit)


def find_implausible(
    track: Track | None, steer: Signal | None, wheel: Signal | None, gyro: Signal | None
) -> list[str]:
    """Find signs of a wrong unit, sign or axis; one sentence each."""
    doubt = "" if steer is None else check_steering(steer.values)
    warnings = [doubt] if doubt else []
    if track is None:
        return warnings
    extent, fastest = max(np.ptp(track.x), np.ptp(track.y)), make_range(np.abs(track.speed))
    if extent > _EXTENT_MAX and fastest and fastest.high > _SPEED_MAX:
        far = f"x, y span {extent:.4g} m at {fastest.high:.3g} m/s"
        warnings.append(f"{far}: are they in millimetres?")
    heading = _check_heading(track) or _check_front(track, wheel)
    return [*warnings, *(heading or _check_signals(track, steer, wheel, gyro))]


def check_steering(values: Array) -> str:
    """What is odd about steering that no wheel does; nothing of a plausible one."""
    found = make_range(values)
    worst = 0.0 if found is None else max(-found.low, found.high)
    return f"steering reaches {worst:.3g} rad: is it in degrees?" if worst > pi / 2 else ""


def _check_heading(track: Track) -> list[str]:
    """Compare the turning of the path with that of the body, over steps of 5 cm and more."""
    distance = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(track.x), np.diff(track.y)))))
    total = float(distance[-1])
    if not 1.0 <= total < 1e7:
        return []
    at = np.arange(0.0, total, max(_STEP, total / _STEPS_MAX))
    x, y = np.interp(at, distance, track.x), np.interp(at, distance, track.y)
    yaw = np.interp(at[1:-1], distance, track.yaw)
    path = _wrap(np.diff(np.arctan2(np.diff(y), np.diff(x))))
    turn = np.diff(yaw, append=yaw[-1:])
    usable = np.abs(path) < 1.0
    path, turn = path[usable], turn[usable]
    if np.sum(np.abs(path)) < 1.0 or not np.any(turn):
        return []
    miss = [float(np.sum(np.abs(_wrap(path - _wrap(turn * k))))) for k in (1.0, pi / 180, -1.0)]
    if np.max(np.abs(track.yaw)) > 2 * pi and miss[1] < 0.5 * miss[0]:
        return ["yaw turns 57 times as much as the path: is it in degrees?"]
    if miss[2] < 0.5 * miss[0]:
        return ["yaw turns against the path: is it clockwise, or are x and y swapped?"]
    return []


def _check_front(track: Track, wheel: Signal | None) -> list[str]:
    """Whether the poses move backwards throughout, and the wheels do not."""
    moving = np.abs(np.nan_to_num(track.speed)) > _DRIVING
    if np.count_nonzero(moving) < _SAMPLES_MIN or np.mean(track.speed[moving] < 0.0) < _SHARE:
        return []
    if wheel is not None and wheel.values.size and float(np.nanmedian(wheel.values)) < 0.0:
        return []
    return ["the car drives backwards throughout: does yaw point to its rear, 180° off?"]


def _wrap(angle: Array) -> Array:
    return np.asarray((angle + pi) % (2 * pi) - pi)


def _check_signals(
    track: Track, steer: Signal | None, wheel: Signal | None, gyro: Signal | None
) -> Iterator[str]:
    """Wheels, gyro and steering against the motion that the poses show."""
    if wheel is not None and (found := _while_driven(track, wheel)):
        speed, _, value = found
        ratio = float(np.sum(np.abs(value)) / np.sum(np.abs(speed)))
        if not _RATIO_LOW <= ratio <= _RATIO_HIGH:
            kinds = {"millimetres": 1e3, "km/h": 3.6, "degrees": 57.3, "millimetres (x, y)": 1e-3}
            near = [n for n, factor in kinds.items() if _RATIO_LOW <= ratio / factor <= _RATIO_HIGH]
            guess = f": {near[0]}?" if near else ": another unit, gear ratio or wheel?"
            yield f"the wheel drives {ratio:.3g} times the path{guess}"
    if gyro is not None:
        rate = np.interp(gyro.t, track.t, np.nan_to_num(track.yaw_rate), np.nan, np.nan)
        both = np.isfinite(rate) & np.isfinite(gyro.values)
        strength = float(np.sum(rate[both] ** 2))
        turns = strength > _TURNING**2 * np.count_nonzero(both)
        slope = float(np.sum(rate[both] * gyro.values[both])) / strength if turns else 1.0
        if slope > 20.0:
            yield f"yaw_rate is {slope:.3g} times the turning of the poses: is it in degrees/s?"
        elif slope < -0.3:
            yield "yaw_rate has the opposite sign of the poses' turning"
    if steer is not None and (found := _while_driven(track, steer, _STEER_LATENCY)):
        speed, turning, value = found
        curvature = turning / speed
        strength = float(np.sqrt(np.sum(curvature**2) * np.sum(value**2)))
        if strength > 0.0 and float(np.sum(curvature * value)) / strength < -0.5:
            yield "the car turns right where steer_cmd is positive: steer_cmd must be left positive"


# -- the lateral error, one definition for every page ----------------------------------------------

SETTLE = 3.0  # the approach to the lane at the start of a drive is left out of the errors [s]


def find_settled(state: Columns, t: Array) -> NDArray[np.bool_]:
    """Which rows of the `state` topic, at these times [s], were driven for more than `SETTLE`."""
    running = state["mode"] == SupervisorState.RUNNING
    begins = running & ~np.concatenate(([False], running[:-1]))
    since = np.maximum.accumulate(np.where(begins, t, -np.inf))
    return np.asarray(running & (t - since >= SETTLE))


def settled_errors(state: Columns, t: Array) -> Array:
    """Sizes of the lateral error while the car was driven and had settled [m]."""
    e1 = np.abs(state["e1"][find_settled(state, t)])
    return np.asarray(e1[np.isfinite(e1)], dtype=np.float64)


def rms(errors: Array) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")
