"""The steering loop as a linear system: lane errors, servo lag, dead time, sampling.

The one place that says what the gains of a design multiply; the designs and the check of the closed
loop both start here. The vehicle's part comes from `steerd.car_model.linear`.
"""

# Why: docs/decisions/filter-and-controller.md#d10

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from steerd.car_model.actuators import LAG_FLOOR
from steerd.car_model.linear import augmented, lane_error_model, sample
from steerd.car_model.params import Car
from steerd.controller.gain_table import N_LANE, Turning

Matrix = npt.NDArray[np.float64]


class Timing(NamedTuple):
    """What time costs the loop."""

    rate_hz: float  # ticks per second
    delay_s: float
    """Dead time from the estimate's moment to the wheel beginning to follow [s], in total."""
    lag_s: float  # first-order lag of the servo [s]

    @property
    def lagging(self) -> bool:
        """Whether the servo has a lag worth a state."""
        return self.lag_s > LAG_FLOOR

    @property
    def period_s(self) -> float:
        """Time between ticks [s]."""
        return 1.0 / self.rate_hz


def steering_chain(car: Car[float], speed: float, timing: Timing) -> tuple[Matrix, Matrix]:
    """Continuous `(A, B)` of `(e1, e1', e2, e2', wheel)` under the steering reference [rad].

    Without a lag worth the name the wheel is the input itself and there are four states.
    """
    model = lane_error_model(car, speed)
    if not timing.lagging:
        return model.a, model.b_steer[:, None]
    a, b = np.zeros((N_LANE, N_LANE)), np.zeros((N_LANE, 1))
    a[:4, :4], a[:4, 4] = model.a, model.b_steer
    a[4, 4], b[4, 0] = -1.0 / timing.lag_s, 1.0 / timing.lag_s
    return a, b


def sampled_loop(car: Car[float], speed: float, timing: Timing) -> tuple[Matrix, Matrix]:
    """Discrete `(A, B)` of the chain and the references within the dead time, newest first."""
    a, b = steering_chain(car, speed, timing)
    return augmented(sample(a, b, timing.period_s, timing.delay_s))


def pack_gains(gains: Matrix, chained: bool) -> tuple[float, ...]:
    """A design's gains as a table row has them: five, then one for each past reference.

    `chained` says whether the wheel angle was a state of the design.
    """
    flat = tuple(float(gain) for gain in np.ravel(gains))
    return flat if chained else (*flat[:4], 0.0, *flat[4:])


def turn_response(car: Car[float], speed: float) -> Turning:
    """What keeps e1 at zero on a path whose curvature k changes steadily in time.

    With errors `x = x0 k + x1 k'` and the wheel likewise, `x' = a x + b wheel + c k` gives
    `a x0 + b w0 = -c` and `a x1 + b w1 = x0`; e1 and e1' are zero, e2' is the change of e2.
    """
    model = lane_error_model(car, speed)
    rows = [1, 3]
    known = np.column_stack([model.a[rows, 2], model.b_steer[rows]])
    heading, wheel = np.linalg.solve(known, -model.b_curvature[rows])
    pull = -model.a[rows, 3] * heading
    heading_change, wheel_change = np.linalg.solve(known, pull)
    return Turning(float(wheel), float(wheel_change), float(heading), float(heading_change))
