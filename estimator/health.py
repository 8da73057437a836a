"""Health of the filter: what watchdogs W5 (innovations) and W6 (covariance) need to know.

Every fused measurement carries running totals up to itself. The statistics of a window are the
difference of two totals, so they cost the same however many measurements the window holds, and
follow the measurements when a late one changes the decisions after it.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from steerd.estimator.initial import Array, Belief
from steerd.estimator.sensors import Kind
from steerd.steer_bus.quick_values import quick_init, quick_value

SECONDS = 1e-9


@quick_value
class Count:
    """Running totals of one instrument."""

    seen: int = 0
    refused: int = 0
    streak: int = 0  # refused in a row, up to now
    nis: float = math.nan  # normalised innovation squared of the last one, believed or not
    nis_sum: float = 0.0  # over those believed
    believed_ns: int = 0  # time of validity of the last one believed [ns]


class Tally(NamedTuple):
    """Running totals of all instruments, in the order of `Kind`."""

    wheel_speed: Count = Count()
    gyro: Count = Count()
    pose: Count = Count()


@quick_init
@dataclass(frozen=True, slots=True)
class SensorHealth:
    """One instrument over the last `HEALTH_WINDOW_S`, and since the filter started."""

    age_s: float
    """Since the last reading that was believed [s]: how long the filter has coasted without it."""
    nis: float  # of the last reading; NaN before the first
    nis_mean: float
    """Of the readings believed in the window (about the number of values when consistent)."""
    refused_in_row: int
    refused_share: float  # refused among all in the window (0 when there were none)
    refused: int
    seen: int


@quick_init
@dataclass(frozen=True, slots=True)
class FilterHealth:
    """The filter's own view of itself at one instant."""

    sound: bool  # mean and covariance are finite, the covariance positive definite
    position_sd: float  # along the worst direction [m]; NaN when not sound
    yaw_sd: float  # [rad]; NaN when not sound
    pose: SensorHealth
    wheel_speed: SensorHealth
    gyro: SensorHealth
    untimely: int  # measurements that came too late to be fused, or from the future


def count_measurement(tally: Tally, kind: Kind, t_ns: int, nis: float, believed: bool) -> Tally:
    """The totals after one more measurement."""
    old = tally[kind]
    if believed:
        new = Count(old.seen + 1, old.refused, 0, nis, old.nis_sum + nis, t_ns)
    else:
        new = Count(
            old.seen + 1, old.refused + 1, old.streak + 1, nis, old.nis_sum, old.believed_ns
        )
    counts = list(tally)
    counts[kind] = new
    return Tally(*counts)


def make_health(
    belief: Belief, sound: bool, t_ns: int, before: Tally, now: Tally, untimely: int
) -> FilterHealth:
    """Health at `t_ns`, with the totals at the beginning of the window and now.

    `sound` says whether the belief is finite and its covariance positive definite.
    """
    covariance = belief.covariance
    return FilterHealth(
        sound=sound,
        position_sd=worst_sd(covariance[:2, :2]) if sound else math.nan,
        yaw_sd=math.sqrt(covariance[2, 2]) if sound else math.nan,
        pose=_sensor_health(before.pose, now.pose, t_ns),
        wheel_speed=_sensor_health(before.wheel_speed, now.wheel_speed, t_ns),
        gyro=_sensor_health(before.gyro, now.gyro, t_ns),
        untimely=untimely,
    )


def worst_sd(block: Array) -> float:
    """Standard deviation along the worst direction of a (2, 2) covariance."""
    (a, b), (_, c) = block.tolist()
    return math.sqrt(0.5 * (a + c) + math.hypot(0.5 * (a - c), b))


def _sensor_health(before: Count, now: Count, t_ns: int) -> SensorHealth:
    seen, refused = now.seen - before.seen, now.refused - before.refused
    believed = seen - refused
    ever = now.believed_ns > 0
    return SensorHealth(
        age_s=(t_ns - now.believed_ns) * SECONDS if ever else math.inf,
        nis=now.nis,
        nis_mean=(now.nis_sum - before.nis_sum) / believed if believed else math.nan,
        refused_in_row=now.streak,
        refused_share=refused / seen if seen else 0.0,
        refused=now.refused,
        seen=now.seen,
    )
