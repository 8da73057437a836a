"""How far a steering loop is from instability: the least distance of its response from -1.

At distance M the steering may be 1 / (1 - M) times as strong or 1 / (1 + M) times as weak, or late
by 2 asin(M / 2), and the loop is still stable: gain and phase margin in one number (Astrom and
Murray, Feedback Systems, section 10.3).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from steerd.car_model.params import Car
from steerd.controller.design import Stability, closed_loop, stability
from steerd.controller.gain_table import N_LANE
from steerd.controller.loop_model import Timing, sampled_loop

SLOWEST, POINTS = 0.05, 120
"""Lowest frequency that is looked at [rad/s], and how many up to half the sampling frequency."""


class Margins(NamedTuple):
    """A loop at one speed."""

    stability: Stability
    """Of the closed loop."""
    distance: float
    """Of the open loop's response from -1; 1 is the best that a loop with integrators has."""


def margins(
    car: Car[float], row: Sequence[float], pasts: int, speed: float, timing: Timing
) -> Margins:
    """Stability and distance of a row of gains on a car, see `closed_loop`.

    The loop is cut where the steering acts: what the controller remembers of its own references is
    part of the controller.
    """
    closed = closed_loop(car, row, pasts, speed, timing)
    lane = N_LANE if timing.lagging else 4
    free = sampled_loop(car, speed, timing)[0][:lane, :lane]
    z = np.exp(1j * np.geomspace(SLOWEST * timing.period_s, np.pi, POINTS))
    remembered = np.asarray(row[N_LANE : N_LANE + pasts])
    memory = 1.0 + (z[:, None] ** -np.arange(1.0, pasts + 1.0)) @ remembered
    poles, zeros = _far_from(z, free), _far_from(z, closed)
    distance = float(np.min(zeros / np.maximum(poles * np.abs(memory), 1e-300)))
    return Margins(stability(closed, speed, timing.period_s), distance)


def _far_from(z: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(points,) product of the distances of each z from the eigenvalues of a matrix."""
    return np.asarray(np.prod(np.abs(z[:, None] - np.linalg.eigvals(matrix)), axis=1))
