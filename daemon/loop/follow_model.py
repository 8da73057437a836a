"""The cars that a car file allows: ranges of what decides how they follow orders (W30, W31)."""

from collections.abc import Mapping
from math import sqrt
from typing import NamedTuple

from steerd.car_model.params import GRAVITY, Car
from steerd.daemon.settings.thresholds import Thresholds
from steerd.estimator.config import FilterConfig
from steerd.steer_bus.quick_values import quick_value

LATE_S = 0.012
"""An order may reach wheels or servo later than the dead time: half a servo pulse, a reply [s]."""
UNKNOWN = 3.0
"""Factor by which a lag, a slew rate or a dead time may be off before `identify` has seen it."""
UNKNOWN_BIAS = 0.05
"""Wheel angle at order zero that a car may have before `identify` has seen it [rad]."""
UNKNOWN_LATE_S = 0.05  # dead time that a car may have before `identify` has seen it [s]
SURE = 3.0  # standard errors of an identified value that count as possible
SPEED_MARGIN_MAX, TURN_MARGIN_MAX = 0.5, 0.05
"""Noise that a car file may claim [m/s], [rad]: beyond, the watchdog would see nothing."""


@quick_value
class Band:
    """Lower and upper end of a quantity."""

    low: float
    high: float


class Actuator(NamedTuple):
    """What an actuator can do at least and at most."""

    lag: Band  # [s]
    slew: Band  # limit of the rate, per second; `fall` that towards lower values
    fall: Band  # the same
    delay: Band  # dead time [s]
    soonest_ns: int  # the shortest dead time [ns]; `latest_ns` the longest
    latest_ns: int  # the same


class FollowModel(NamedTuple):
    """All cars within the share, as ranges of what matters."""

    drive: Actuator  # motor; rates in m/s^2
    servo: Actuator  # rates in rad/s
    gain: Band  # wheel angle per ordered angle
    bias: float  # wheel angle at order zero [rad]
    left: Band  # end stop [rad]; `right` the other, negative
    right: Band  # the same
    # Wheelbase [m]. Gain and wheelbase are off independently: together by the root of the sum of
    # squares, of which the gain has its full share.
    base: Band
    understeer: Band  # growth of the wheel angle per lateral acceleration [rad s^2/m]
    settling: float  # time constant of yaw per speed [s^2/m]
    slack: float  # wheel angle that no file knows: bias, play [rad]
    speed_margin: float  # noise of the wheel speed [m/s]
    turn_margin: float  # noise of a turn between two poses [rad]
    latest_ns: int  # the longest dead time of the two actuators [ns]


def make_follow_model(
    car: Car[float], known: Mapping[str, float], config: FilterConfig, th: Thresholds
) -> FollowModel:
    """The ranges for a car; `known`: standard errors of what was identified, by parameter."""
    share = th.follow_share
    soft = 1.0 / (GRAVITY * car.mu * (1.0 - share) ** 2)
    stiff = 1.0 / (GRAVITY * car.mu * (1.0 + share) ** 2)
    # Understeer of the single-track model: 1/g (1/(mu C_f) - 1/(mu C_r)), Rajamani, section 3.3.
    understeer = Band(stiff / car.c_sf - soft / car.c_sr, soft / car.c_sf - stiff / car.c_sr)
    length = car.lf + car.lr
    cf, cr = (c * car.mu * car.mass * GRAVITY for c in (car.c_sf * car.lr, car.c_sr * car.lf))
    slowest = max(
        car.inertia_z * length / (cf * car.lf**2 + cr * car.lr**2), car.mass * length / (cf + cr)
    )
    noise = th.follow_noise
    pushed = ("speed_lag", "accel_max", "decel_max", "drive_delay")
    steered = ("steer_lag", "steer_rate", "steer_rate", "steer_delay")
    drive, servo = (_make_actuator(car, known, share, names) for names in (pushed, steered))
    return FollowModel(
        drive=drive,
        servo=servo,
        gain=_around(car.steer_gain, share),
        bias=car.steer_bias,
        left=_around(car.steer_max, share),
        right=_around(car.steer_min, share),
        base=_around(length, (sqrt(2.0) - 1.0) * share),
        understeer=understeer,
        settling=slowest * (1.0 + 2.0 * share),
        slack=th.follow_steer if "steer_bias" in known else max(th.follow_steer, UNKNOWN_BIAS),
        speed_margin=min(noise * config.wheel_speed_sd, SPEED_MARGIN_MAX),
        turn_margin=min(noise * sqrt(2.0) * config.pose_yaw_sd, TURN_MARGIN_MAX),
        latest_ns=max(drive.latest_ns, servo.latest_ns),
    )


def _around(value: float, share: float) -> Band:
    off = abs(value) * share
    return Band(value - off, value + off)


def _make_actuator(
    car: Car[float], known: Mapping[str, float], share: float, names: tuple[str, str, str, str]
) -> Actuator:
    """The ranges of one actuator; `names` are those of lag, slew rates and dead time."""

    def possible(name: str) -> Band:
        value = float(getattr(car, name))
        if name not in known:
            return Band(value / UNKNOWN, value * UNKNOWN)
        off = max(share * value, SURE * known[name])
        return Band(max(0.0, value - off), value + off)

    lag, rise, fall, late = map(possible, names)
    slack = LATE_S if names[-1] in known else max(LATE_S, UNKNOWN_LATE_S - late.high)
    delay = Band(late.low, late.high + slack)
    return Actuator(lag, rise, fall, delay, *(round(1e9 * end) for end in (delay.low, delay.high)))
