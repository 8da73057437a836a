"""Health of the filter: what watchdogs W5 (innovations) and W6 (covariance) need to know.

Every fused measurement carries running totals up to itself, so that they follow the measurements
when a late one changes the decisions after it.
"""

import math

from steerd.estimator.sensors import Kind
from steerd.steer_bus.quick_values import quick_value

SECONDS = 1e-9


@quick_value
class Count:
    """Running totals of one instrument."""

    seen: int = 0
    refused: int = 0
    nis: float = math.nan  # normalised innovation squared of the last one, believed or not
    believed_ns: int = 0  # time of validity of the last one believed [ns]

    def age_s(self, t_ns: int) -> float:
        """Time for which the filter has coasted without a reading that it believed [s]."""
        return (t_ns - self.believed_ns) * SECONDS if self.believed_ns > 0 else math.inf


Tally = tuple[Count, ...]
"""Running totals of all instruments, in the order of `Kind`."""
NO_TALLY: Tally = (Count(),) * len(Kind)


@quick_value
class FilterHealth:
    """The filter's own view of itself at one instant."""

    sound: bool  # mean and covariance are finite, the covariance positive definite
    position_sd: float  # along the worst direction [m]; NaN when not sound
    yaw_sd: float  # [rad]; NaN when not sound
    wheel_speed: Count
    gyro: Count
    pose: Count


def count_measurement(tally: Tally, kind: Kind, t_ns: int, nis: float, believed: bool) -> Tally:
    """The totals after one more measurement."""
    old = tally[kind]
    last_ns = t_ns if believed else old.believed_ns
    new = Count(old.seen + 1, old.refused + (not believed), nis, last_ns)
    return (*tally[:kind], new, *tally[kind + 1 :])
