"""The gap over other horizons than the diagnosis' own second: a cross-check.

Over a quarter of a second delays and gains barely show and noise rules; over three seconds small
errors have added up. A cause that is right makes the error smaller on both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.engine import Engine, make_engine
from steerd.sysid.inference.levenberg_marquardt import Fitted
from steerd.sysid.inference.noise import Noise, whitened
from steerd.sysid.inference.readings import make_readings
from steerd.sysid.inference.residuals import Gap, blocks_of, gap_of, settled

CROSS: tuple[float, ...] = (0.25, 3.0)
"""Horizons of the cross-check [s]."""
_WHEEL, _GYRO = 0.05, 0.05
"""Instruments' noise before whitening [m/s], [rad/s]."""


@dataclass(frozen=True)
class Horizon:
    """Whitened error per degree of freedom over one horizon [s]; 1 is noise alone."""

    seconds: float
    before: float
    after: float


def _engine(engine: Engine, runs: Sequence[Run], noise: Noise, seconds: float) -> Engine:
    late = float(engine.superset.base[engine.superset.kernels.names.index("pose_delay")])
    readings = make_readings(runs, late, engine.readings.speeds, seconds)
    rough = np.array([*noise.instruments[:2], _WHEEL, _GYRO])
    return make_engine(engine.superset, readings, rough)


def cross_check(
    engine: Engine,
    runs: Sequence[Run],
    before: Fitted,
    after: Fitted,
    noise: Noise,
    gaps: tuple[Gap, Gap],
) -> tuple[tuple[Horizon, ...], Gap, Gap]:
    """Whitened errors over `CROSS`, and the gaps with the errors at the longest lead added.

    Horizons longer than the drives, or over which the simulation diverges, are left out.
    """
    found = []
    for seconds in CROSS:
        if seconds > 0.5 * min(run.driven for run in runs):
            continue
        try:
            other = _engine(engine, runs, noise, seconds)
            best = settled(other, after.space, after.z)
            other = whitened(other, best, noise)
            fits = [settled(other, f.space, f.z) for f in (before, after)]
        except (FloatingPointError, ValueError, np.linalg.LinAlgError):
            continue
        lead = seconds if seconds > 1.0 else 0.25
        there = [gap_of(other, fit, blocks_of(other), (lead,)) for fit in fits]
        found.append(Horizon(seconds, there[0].whitened, there[1].whitened))
        if seconds > 1.0:
            gaps = (_longer(gaps[0], there[0]), _longer(gaps[1], there[1]))
    return tuple(found), *gaps


def _longer(gap: Gap, more: Gap) -> Gap:
    return replace(
        gap, errors=(*gap.errors, *more.errors), intervals=(*gap.intervals, *more.intervals)
    )
