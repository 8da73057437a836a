"""The windows' starts at their best, the car held (Levenberg and Marquardt, window by window).

Yaw rate and slip at a start fade within some hundredths of a second, and poses barely show them:
where tyres saturate a full Newton step leads away.
"""

# Why: docs/decisions/diagnosis.md#d91

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.inference.likelihood import Likelihood, take_some

Array = NDArray[np.float64]

OWED = 0.05
"""A start whose next step promises no more off the window's square is at its best."""
_ROUNDS = 20
_FEWER = 0.7
"""Windows that still move are taken out where they are a smaller share."""
_DAMPING, _EASIER, _HARDER, _STUCK = 1e-3, 0.1, 10.0, 1e5
"""Damping at first, factors after a better and a worse step, and where no step is better."""


def settle_starts(
    likelihood: Likelihood, parameters: Array, x: Array, size: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Starts (W, 7) at their best, and which (W,) keep no promise: they stay where they are.

    Args:
        likelihood: the windows.
        parameters: (P,) of the car.
        x: (W, 7) where the starts are.
        size: of the discrepancy.
    """
    x, damping, left = x.copy(), np.full(len(x), _DAMPING), np.zeros(len(x), bool)
    active, part = np.arange(len(x)), likelihood
    for _ in range(_ROUNDS):
        error, by_x = part.predictor.by_starts(parameters, x[active])
        turned, curved = part.start_curvature(part.rotation @ by_x, size)
        pull = part.start_pull(turned, part.rotate_error(error), x[active])
        promised = (pull * np.linalg.solve(curved, pull[:, :, None])[:, :, 0]).sum(axis=1)
        owed = promised > OWED
        left[active] = owed
        moving = owed & (damping[active] < _STUCK)
        if not moving.any():
            break
        if moving.mean() < _FEWER:
            active, part = active[moving], take_some(part, moving)
            curved, pull = curved[moving], pull[moving]
            error = error[moving, : part.predictor.padded.there.shape[1]]
        before = part.squares(error, x[active], size)
        diagonal = damping[active, None] * np.diagonal(curved, axis1=1, axis2=2)
        damped = curved + diagonal[:, :, None] * np.eye(curved.shape[1])
        tried = x[active] + np.linalg.solve(damped, pull[:, :, None])[:, :, 0]
        off, _ = part.predictor.errors(parameters, tried)
        better = part.squares(off, tried, size) < before
        x[active[better]] = tried[better]
        damping[active] *= np.where(better, _EASIER, _HARDER)
    return x, left
