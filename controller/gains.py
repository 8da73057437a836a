"""The two designs over a grid of speeds. Runs at start, never per tick.

`pole_placement` is the paper's: continuous state feedback on Rajamani's error dynamics, blind to
the servo, the dead time and the loop's rate. `lqr` (default) minimises a quadratic cost of the
sampled loop whose states hold the servo's lag and every reference that the wheel has not followed
yet.
"""

import math

import numpy as np
from scipy import linalg

from steerd.car_model.chassis import SPEED_DYNAMIC
from steerd.car_model.linear import lane_error_model
from steerd.car_model.params import Car
from steerd.controller.config import ControllerConfig, LqrWeights
from steerd.controller.design import DesignRefused
from steerd.controller.gain_table import GainTable
from steerd.controller.loop_model import Matrix, Timing, pack_gains, sampled_loop, turn_response


def pole_placement_gains(car: Car[float], speed: float, poles: tuple[complex, ...]) -> Matrix:
    """Gains (1, 4) on `(e1, e1', e2, e2')` that give the continuous loop these poles [1/s].

    Raises:
        DesignRefused: the poles cannot be placed.
    """
    # Imported here: with the plotting library that it loads it takes a second or two.
    import control  # noqa: TID251

    model = lane_error_model(car, speed)
    try:
        gains: Matrix = np.asarray(control.place(model.a, model.b_steer[:, None], poles))
    except ValueError as error:
        raise DesignRefused(
            f"pole_placement at {speed:.2f} m/s: {error}; try other poles, a higher grid_speed_min "
            "or design = 'lqr'"
        ) from None
    return gains


def lqr_gains(car: Car[float], speed: float, timing: Timing, weights: LqrWeights) -> Matrix:
    """Gains (1, 5 + n), n references within the dead time (4 + n without a lag).

    Those of `control.dlqr` to the last bit, which solves the same equation by the same function.

    Raises:
        DesignRefused: the Riccati equation has no solution.
    """
    a, b = sampled_loop(car, speed, timing)
    lane = 5 if timing.lagging else 4
    cost = np.zeros(len(a))
    cost[:lane] = weights[:lane]
    effort = np.array([[weights.effort]])
    try:
        riccati = linalg.solve_discrete_are(a, b, np.diag(cost), effort)
        gains: Matrix = linalg.solve(b.T @ riccati @ b + effort, b.T @ riccati @ a)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DesignRefused(
            f"lqr at {speed:.2f} m/s, {timing.rate_hz:g} Hz: {error}; try other weights"
        ) from None
    return gains


def design_table(
    car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float
) -> GainTable:
    """Gains of the configured design from its lowest speed up to `speed_max` [m/s].

    Raises:
        DesignRefused: a speed has no design.
    """
    lowest = config.grid_speed_min
    if config.design == "pole_placement":
        lowest = max(lowest, SPEED_DYNAMIC)
    span = max(speed_max - lowest, 0.0)
    steps = max(1, math.ceil(span / config.grid_spacing))
    spacing = span / steps if span > 0.0 else config.grid_spacing
    speeds = [lowest + i * spacing for i in range(steps + 1 if span > 0.0 else 1)]
    rows = tuple(_row(car, config, timing, speed) for speed in speeds)
    return GainTable(lowest, spacing, rows)


def _row(
    car: Car[float], config: ControllerConfig, timing: Timing, speed: float
) -> tuple[float, ...]:
    if config.design == "lqr":
        gains = pack_gains(lqr_gains(car, speed, timing, config.weights), timing.lagging)
    else:
        gains = pack_gains(pole_placement_gains(car, speed, config.poles), chained=False)
    return (*gains, *turn_response(car, speed))
