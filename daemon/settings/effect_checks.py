"""Effects of a size with which no drive ends well are refused when a car file is read.

What they do is asked of the car's own equations, so that no effect is named here.
"""

from math import pi

from steerd.car_model.car_file import CarFile
from steerd.car_model.model import Model, car_now, memory_size, model_rates, observe
from steerd.car_model.nominal_car import believed_car
from steerd.car_model.ops import FLOAT
from steerd.car_model.state import ORIGIN, State
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.thresholds import LAUNCH_SPEED, SOFT_DECEL, Thresholds

HEADING_MOST = 0.1
"""Heading error of the poses beyond which W5 stops a drive [rad]; 0.15 stopped, 0.1 did not."""
_HEADINGS = 24
"""Headings at which a car is let roll."""
_FAR = 1e6
"""Away from places that differ from the rest of the floor [m]."""


def check_effects(file: CarFile, th: Thresholds) -> None:
    """Refuse a car that its effects keep from stopping, from starting, or from being seen right.

    Raises:
        SteerdError: a watchdog would end each of its drives.
    """
    if not file.model.effects:
        return
    rolling = [_roll(file.model, 2.0 * pi * k / _HEADINGS) for k in range(_HEADINGS)]
    most = (1.0 - th.stop_share) * SOFT_DECEL
    if max(rolling) > most:
        what = (
            f"{file.path}: left to roll, this car speeds up by {max(rolling):.2f} m/s² "
            f"([effects]); with more than {most:.2f} a stop is not distinguishable from none"
        )
        raise SteerdError(what, "measure that floor or that drag; no stop is sure on it")
    lack, allowed = (
        -min(rolling) * believed_car(file.model).speed_lag,
        th.follow_share * LAUNCH_SPEED,
    )
    if lack > allowed * (1.0 + 1e-6):
        what = (
            f"{file.path}: this car lags {lack:.2f} m/s behind its orders ([effects], speed_lag); "
            f"W30 lets {allowed:.2f} pass at a start"
        )
        raise SteerdError(what, "identify speed_lag and drag; a tight speed loop has no such lag")
    off = observe(FLOAT, file.model, _at(0.0)).yaw
    if abs(off) > HEADING_MOST:
        what = f"{file.path}: mocap shows a heading {off:+.2f} rad off the car's ([effects])"
        raise SteerdError(what, "turn the body by [mocap] mount_yaw_deg: `steerd mocap calibrate`")


def _at(heading: float) -> State[float]:
    return ORIGIN._replace(x=_FAR, y=_FAR, yaw=heading, speed=1.0)


def _roll(model: Model[float], heading: float) -> float:
    """Acceleration of a car that rolls straight on [m/s^2]."""
    state = _at(heading)
    car = car_now(FLOAT, model, state, 0.0)
    memory = (0.0,) * memory_size(model.effects)
    return model_rates(FLOAT, model, car, memory, state, 0.0, 0.0).speed
