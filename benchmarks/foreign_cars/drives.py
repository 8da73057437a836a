"""Commands for foreign cars: the manoeuvres of the blind test, harder and longer."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_gap.drives import LEAD, Temper, _speed_plan, _steer_plan
from benchmarks.blind_gap.plant import STEP, TICK

Array = NDArray[np.float64]

TEMPERS = {
    "rich": Temper(1.0, 3.0, 9.0, 0.0, 1.0),
    "medium": Temper(0.8, 2.5, 4.0, 0.08, 0.7),
    "gentle": Temper(0.7, 1.8, 1.5, 0.3, 0.35),
}
"""Speeds [m/s], lateral acceleration asked for at most [m/s^2], softening [s], tempo."""
SECONDS = 45.0
PUSH = 0.3
"""Disturbances per those of the blind test (0.4 m/s^2, 2.5 rad/s^2, 0.08 s). At 1 they move a car
by 20 to 38 mm in a second, more than the 12 to 16 mm that a good model leaves of real drives."""
LEAD_TICKS = LEAD // TICK


@dataclass(frozen=True, slots=True)
class Commands:
    """Commands at 100 Hz; the first `LEAD_TICKS` rows are a lead-in, not recorded.

    Attributes:
        steer: wheel angle [rad], left positive.
        speed: speed [m/s].
        start: x, y, yaw, speed when the lead-in begins.
        push: disturbances, per those of the blind test.
    """

    steer: Array
    speed: Array
    start: Array
    push: float = PUSH

    @property
    def steps(self) -> int:
        """Milliseconds of driving, lead-in included."""
        return len(self.steer) * TICK


def make_commands(
    temper: str, seconds: float, rng: np.random.Generator, push: float = PUSH
) -> Commands:
    """Step steers, slaloms, chirps, ramps and speed steps, drawn one after the other.

    Args:
        temper: `rich`, `medium` or `gentle`.
        seconds: length of the recording.
        rng: where the drive comes from.
        push: disturbances, per those of the blind test.
    """
    kind, ticks = TEMPERS[temper], round(seconds / (STEP * TICK))
    speed = _speed_plan(kind, ticks, rng)
    steer = _steer_plan(kind, speed, rng)
    steer[:20] *= np.linspace(0.0, 1.0, 20)
    x, y = rng.uniform(-1.0, 1.0, 2)
    start = np.array([x, y, rng.uniform(-np.pi, np.pi), speed[0]])
    return replace(make_plan(steer, speed, start), push=push)


def make_plan(steer: Array, speed: Array, start: Array | None = None) -> Commands:
    """Commands at 100 Hz with the lead-in that holds their first values.

    Args:
        steer: wheel angles [rad].
        speed: speeds [m/s].
        start: x, y, yaw, speed; by default at the origin at the first speed.
    """
    return Commands(
        np.concatenate([np.full(LEAD_TICKS, steer[0]), steer]),
        np.concatenate([np.full(LEAD_TICKS, speed[0]), speed]),
        np.array([0.0, 0.0, 0.0, speed[0]]) if start is None else start,
    )
