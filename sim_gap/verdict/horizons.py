"""The gap over other horizons than the diagnosis' own second: a cross-check.

Over a quarter of a second delays and gains barely show and noise rules; over three seconds small
errors have added up. A cause that is right makes the error smaller on both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.engine import Engine, open_engine
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.residuals import Gap, blocks_of, gap_of, settled, spun_windows
from steerd.sysid.inference.search import Point

CROSS: tuple[float, ...] = (0.25, 3.0)
"""Horizons of the cross-check [s]."""


@dataclass(frozen=True)
class Horizon:
    """Whitened error per degree of freedom over one horizon [s]; 1 is noise alone."""

    seconds: float
    before: float
    after: float


def cross_check(
    engine: Engine,
    runs: Sequence[Run],
    before: Point,
    after: Point,
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
            other = open_engine(engine.superset, runs, seconds)
            guess = other.readings.layout.guess.copy()
            likelihood = make_likelihood(other, after.parameters, guess, noise)
            fits = [settled(likelihood, f.space, f.z) for f in (before, after)]
        except (FloatingPointError, ValueError, np.linalg.LinAlgError):
            continue
        lead = seconds if seconds > 1.0 else 0.25
        spun, blocks = spun_windows(fits[1]), blocks_of(other)
        there = [gap_of(other, fit, blocks, spun, (lead,)) for fit in fits]
        found.append(Horizon(seconds, there[0].whitened, there[1].whitened))
        if seconds > 1.0:
            gaps = (_longer(gaps[0], there[0]), _longer(gaps[1], there[1]))
    return tuple(found), *gaps


def _longer(gap: Gap, more: Gap) -> Gap:
    return replace(
        gap, errors=(*gap.errors, *more.errors), intervals=(*gap.intervals, *more.intervals)
    )
