"""The lateral error of a drive, once it has settled on its lane: one definition for every page."""

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.motion import Array
from steerd.steer_bus.topic_columns import Columns

SETTLE = 3.0  # the approach to the lane at the start of a drive is left out of the errors [s]


def find_settled(state: Columns, t: Array) -> NDArray[np.bool_]:
    """Which rows of the `state` topic, at these times [s], were driven for more than `SETTLE`."""
    running = state["mode"] == SupervisorState.RUNNING
    begins = running & ~np.concatenate(([False], running[:-1]))
    since = np.maximum.accumulate(np.where(begins, t, -np.inf))
    return np.asarray(running & (t - since >= SETTLE))


def settled_errors(state: Columns, t: Array) -> Array:
    """Sizes of the lateral error while the car was driven and had settled [m]."""
    e1 = np.abs(state["e1"][find_settled(state, t)])
    return np.asarray(e1[np.isfinite(e1)], dtype=np.float64)


def rms(errors: Array) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")
