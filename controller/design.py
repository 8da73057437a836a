"""The check before driving: eigenvalues of the discrete closed loop, for the real rate and delay.

A state feedback that is fine on paper can be unstable in a sampled loop: the paper's own poles have
a spectral radius of 0.98 at 100 Hz and 1 m/s, and 1.18 once a single tick of delay is there.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from steerd.car_model.params import Car
from steerd.controller.gain_table import N_LANE, GainTable, look_up
from steerd.controller.loop_model import Matrix, Timing, sampled_loop

SPEEDS_BELOW = (0.2, 0.5, 0.8)
"""Shares of the lowest design speed at which the held gains are checked too."""
MARGIN_STEP_S = 0.005  # resolution of the delay margin [s]
MARGIN_MAX_S = 0.2  # delay margins beyond this are not resolved [s]
TINY = 1e-300  # keeps an eigenvalue of exactly one, or a pole on the way, from dividing by zero
LASTING_S, LASTING_SHARE = 0.1, 0.1
"""A mode counts for the damping if this share of it is left after that time [s]. Faster ones, such
as the dead time's own (n eigenvalues near zero, which the least change sends round a circle of
radius eps^(1/n)), are gone before they show."""

SLOWEST, POINTS = 0.05, 120
"""Lowest frequency that is looked at [rad/s], and how many up to half the sampling frequency."""


class DesignRefused(ValueError):  # noqa: N818
    """No controller that may drive: names speed, rate and delay, and what to try."""


class Stability(NamedTuple):
    """How the closed loop behaves at one speed."""

    speed: float  # [m/s]
    radius: float  # largest magnitude of an eigenvalue: below 1 is stable
    damping: float
    """Smallest damping ratio of a lasting mode: negative is unstable, 1 does not oscillate."""


class DesignReport(NamedTuple):
    """What was designed and how the closed loop will behave."""

    design: str
    timing: Timing
    stabilities: tuple[Stability, ...]
    delay_margin_s: float
    """Dead time that may be added before a speed becomes unstable [s], up to MARGIN_MAX_S."""

    @property
    def worst(self) -> Stability:
        """The speed nearest to instability."""
        return min(self.stabilities, key=lambda at: (at.damping, -at.radius))

    def describe(self) -> str:
        """One line for people."""
        low, high = self.stabilities[0].speed, self.stabilities[-1].speed
        return (
            f"{self.design}, {describe_timing(self.timing)}, {low:.2f} to {high:.2f} m/s: spectral "
            f"radius up to {max(at.radius for at in self.stabilities):.4f}, damping at least "
            f"{self.worst.damping:.2f}, tolerates {1e3 * self.delay_margin_s:.0f} ms more delay"
        )


def describe_timing(timing: Timing) -> str:
    """Rate, dead time and lag for people."""
    return (
        f"{timing.rate_hz:g} Hz, {1e3 * timing.delay_s:.1f} ms dead time, "
        f"{1e3 * timing.lag_s:.0f} ms servo lag"
    )


def closed_loop(
    car: Car[float], row: Sequence[float], pasts: int, speed: float, timing: Timing
) -> Matrix:
    """The closed loop's state matrix over one tick, of the car and timing as they are, at `speed`.

    The row of the gain table feeds `pasts` references back; the real dead time may differ.
    """
    open_a, open_b = sampled_loop(car, speed, timing)
    lane = N_LANE if timing.lagging else 4
    known = len(open_a)
    size = max(known, lane + pasts)
    a, b = np.zeros((size, size)), np.zeros((size, 1))
    a[:known, :known], b[:known] = open_a, open_b
    for i in range(known, size):
        if i == lane:
            b[i] = 1.0
        else:
            a[i, i - 1] = 1.0
    gains = np.zeros((1, size))
    gains[0, :lane] = row[:lane]
    gains[0, lane : lane + pasts] = row[N_LANE : N_LANE + pasts]
    closed: Matrix = a - b @ gains
    return closed


def stability(closed: Matrix, speed: float, period_s: float) -> Stability:
    """Radius and damping of a closed loop's state matrix over one tick of `period_s`."""
    modes = np.linalg.eigvals(closed).astype(np.complex128)
    sizes = np.abs(modes)
    lasting = sizes >= min(LASTING_SHARE ** (period_s / LASTING_S), float(sizes.max()))
    decay = -np.log(modes[lasting])
    damping = np.real(decay) / np.maximum(np.abs(decay), TINY)
    return Stability(speed, float(sizes.max()), float(damping.min()))


def stability_at(car: Car[float], table: GainTable, speed: float, timing: Timing) -> Stability:
    """Stability of the closed loop of a table's gains at one speed [m/s]."""
    closed = closed_loop(car, look_up(table, speed), table.pasts, speed, timing)
    return stability(closed, speed, timing.period_s)


def assessed_speeds(table: GainTable) -> list[float]:
    """Each design speed, those between them, and some below the lowest [m/s]."""
    grid = table.speeds
    between = [0.5 * (low + high) for low, high in pairwise(grid)]
    below = [share * grid[0] for share in SPEEDS_BELOW]
    return sorted([*below, *grid, *between])


def assess(car: Car[float], table: GainTable, timing: Timing) -> tuple[Stability, ...]:
    """Stability at `assessed_speeds`."""
    return tuple(stability_at(car, table, speed, timing) for speed in assessed_speeds(table))


def delay_margin(car: Car[float], table: GainTable, timing: Timing) -> float:
    """Dead time that can be added with every grid speed still stable [s]."""
    for step in range(1, round(MARGIN_MAX_S / MARGIN_STEP_S) + 1):
        later = timing._replace(delay_s=timing.delay_s + step * MARGIN_STEP_S)
        if any(stability_at(car, table, v, later).radius >= 1.0 for v in table.speeds):
            return (step - 1) * MARGIN_STEP_S
    return MARGIN_MAX_S


def find_faults(stabilities: Sequence[Stability], damping_min: float) -> tuple[Stability, ...]:
    """Speeds, from below, at which the loop is unstable or less damped than required."""
    return tuple(at for at in stabilities if at.radius >= 1.0 or at.damping < damping_min)


def gravest(faults: Sequence[Stability]) -> Stability:
    """The fault to report: the most unstable, or the least damped where all are stable."""
    return max(faults, key=lambda at: (max(at.radius, 1.0), -at.damping))


def margins(
    car: Car[float], row: Sequence[float], pasts: int, speed: float, timing: Timing
) -> tuple[Stability, float]:
    """Stability of the loop of a row of gains on a car, see `closed_loop`, and distance from -1.

    Of the open loop's response; 1 is the best that a loop with integrators has.
    At distance M the steering may be 1 / (1 - M) times as strong or 1 / (1 + M) times as weak, or
    late by 2 asin(M / 2), and the loop is still stable: gain and phase margin in one number (Astrom
    and Murray, Feedback Systems, section 10.3).

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
    distance = float(np.min(zeros / np.maximum(poles * np.abs(memory), TINY)))
    return stability(closed, speed, timing.period_s), distance


def _far_from(z: np.ndarray, matrix: Matrix) -> Matrix:
    """(points,) product of the distances of each z from the eigenvalues of a matrix."""
    return np.asarray(np.prod(np.abs(z[:, None] - np.linalg.eigvals(matrix)), axis=1))
