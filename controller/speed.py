"""How fast to drive where: a profile along the path, and a reference that ramps towards it.

The profile is the usual one: at each place the least of configured speed, file speed and
lateral-acceleration limit, then a backward pass that brakes in time and a forward pass that does
not accelerate harder than allowed. An open path ends standing.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.car_model.path.path import Path, interpolate
from steerd.controller.config import ControllerConfig

ROUNDS = 2  # passes around a closed path: the second carries the first's end into its beginning


class SpeedProfile(NamedTuple):
    """Speed at each sample of a path [m/s]."""

    path: Path
    speed: tuple[float, ...]
    preview_s: float  # how far ahead in time it is read, for the drive's dead time and lag [s]

    @property
    def fastest(self) -> float:
        """[m/s]."""
        return max(self.speed)


def make_speed_profile(car: Car[float], path: Path, config: ControllerConfig) -> SpeedProfile:
    """The profile of a path for a car."""
    file_speeds = path.speed if config.file_speeds and path.speed is not None else None
    caps = [config.speed] * len(path.x)
    for i, curvature in enumerate(path.curvature):
        if curvature != 0.0:
            caps[i] = min(caps[i], math.sqrt(config.lateral_accel_max / abs(curvature)))
        if file_speeds is not None:
            caps[i] = min(caps[i], max(file_speeds[i], 0.0))
    if not path.closed:
        caps[-1] = 0.0
    backwards = _limit_growth(caps[::-1], config.decel_max, path.step, path.closed)
    speeds = _limit_growth(backwards[::-1], config.accel_max, path.step, path.closed)
    return SpeedProfile(path, tuple(speeds), car.drive_delay + car.speed_lag)


def _limit_growth(caps: list[float], accel: float, step: float, closed: bool) -> list[float]:
    """Speeds that grow by at most `accel` along the samples: v^2 by 2 a ds a step."""
    speeds = list(caps)
    order: Iterable[int] = range(1, len(caps))
    if closed:
        order = (i % len(caps) for i in range(1, ROUNDS * len(caps)))
    for i in order:
        speeds[i] = min(speeds[i], math.sqrt(speeds[i - 1] ** 2 + 2.0 * accel * step))
    return speeds


def preview_place(profile: SpeedProfile, s: float, speed: float) -> float:
    """Where a car at `s` [m] that drives `speed` [m/s] is when its drive has followed [m]."""
    return s + max(speed, 0.0) * profile.preview_s


def profile_speed(profile: SpeedProfile, s: float, speed: float) -> float:
    """The profile's speed for a car at `s` [m] that drives `speed` [m/s]."""
    return interpolate(profile.path, profile.speed, preview_place(profile, s, speed))


def step_speed(
    reference: float, target: float, dt: float, config: ControllerConfig, stop: bool
) -> float:
    """The speed reference after `dt` seconds [m/s].

    It climbs to the target at the start ramp, follows it down at once (the profile already brakes
    in time), and on `stop` comes down at the stop ramp.
    """
    if stop:
        return max(0.0, min(reference, reference - config.stop_ramp * dt))
    return min(target, reference + config.start_ramp * dt)
