"""How late a recorder stored the steering commands of a drive."""

# Why: docs/decisions/identification.md#d45

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class LogJitter(NamedTuple):
    """Sampling jitter of a steering log: it is late by `period (phase + drift t) mod period`.

    Attributes:
        run: the drive's name.
        period: of the log [s].
        phase: at the drive's first command, in periods.
        drift: how fast the phase moves [periods/s].
        log_likelihood: gain over a constant delay [nats].
    """

    run: str
    period: float
    phase: float
    drift: float
    log_likelihood: float

    def delay(self, t: Array) -> Array:
        """How late commands logged at `t` were stored [s]."""
        delayed: Array = self.period * np.mod(self.phase + self.drift * t, 1.0)
        return delayed

    def describe(self) -> tuple[str, str]:
        """What was found, and what was done about it."""
        late, drift = 1e3 * self.period, 1e3 * abs(self.drift) * self.period
        found = f"{self.run}: steering stored 0 to {late:.0f} ms late"
        return found, f"(two timers drift apart by {drift:.1f} ms/s), corrected"
