"""A session opened: windows under the base car, and the base at its best within its uncertainty."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise, speed_range
from steerd.sysid.inference.engine import Engine, make_engine
from steerd.sysid.inference.levenberg_marquardt import Fitted, minimise
from steerd.sysid.inference.readings import make_readings
from steerd.sysid.inference.space import make_space
from steerd.sysid.inference.superset import Superset

_ROUGH_NOISE = np.array([5e-3, 0.01, 0.05, 0.05])
"""Instrument noise of the first fit, before noise is learnt: [m], [rad], [m/s], [rad/s]."""


def open_engine(superset: Superset, runs: Sequence[Run]) -> Engine:
    """The windows of some drives, with rough noise."""
    late = float(superset.base[superset.kernels.names.index("pose_delay")])
    readings = make_readings(runs, late, speed_range(runs))
    return make_engine(superset, readings, np.maximum(estimate_noise(runs), _ROUGH_NOISE))


def null_fit(
    engine: Engine,
    nuisance: Sequence[str],
    start: Fitted | None = None,
    effects: Sequence[str] = (),
) -> Fitted:
    """The base with its parameters free within their uncertainty.

    Args:
        engine: the windows.
        nuisance: base parameters that are free.
        start: a fit of the same coordinates to go on from.
        effects: built-in effects of the base that are free as well.

    Raises:
        FloatingPointError: the base car's simulation diverges.
    """
    space = make_space(engine.superset, nuisance, effects)
    if start is not None:
        # A linear step may have left a start where a real car never was; then the poses' own.
        same = start.space.chart.free == space.chart.free
        with suppress(FloatingPointError):
            return minimise(
                engine, space, start.z.copy(), start.x.copy(), known=start.linear if same else None
            )
    return minimise(engine, space, space.centre.copy(), engine.readings.layout.guess.copy())
