"""The windows' starts at their best, the car held (Levenberg and Marquardt, window by window).

Yaw rate and slip at a start fade within some hundredths of a second, and poses barely show them:
where tyres saturate a full Newton step leads away.
"""

# Why: docs/decisions/diagnosis.md#d91

import numpy as np

from steerd.sysid.data.data_checks import Array, Mask
from steerd.sysid.inference.likelihood import Likelihood, loss_of, take_some

OWED = 0.05  # a start whose next step promises less than this is at its best [nats]
_ROUNDS = 20
_FEWER = 0.7  # windows that still move are taken out where they are a smaller share
_DAMPING, _STUCK = 1e-3, 1e5  # damping at first, and where no step is better


def settle_starts(
    likelihood: Likelihood, parameters: Array, x: Array, by: tuple[Array, Array], size: float
) -> tuple[Array, Mask]:
    """Starts (W, 7) at their best, and which (W,) keep no promise: they stay where they are.

    Args:
        likelihood: the windows.
        parameters: (P,) of the car.
        x: (W, 7) where the starts are.
        by: errors (W, D) and derivatives by the starts (W, D, 7) there.
        size: of the discrepancy.
    """
    x, left = x.copy(), np.zeros(len(x), bool)
    damping, harder = np.full(len(x), _DAMPING), np.full(len(x), 2.0)
    active, part = np.arange(len(x)), likelihood
    row, by_x = likelihood.rotate_error(by[0]), by[1]
    for _ in range(_ROUNDS):
        turned, curved = part.start_curvature(part.rotation @ by_x, size)
        pull = part.start_pull(turned, row, x[active])
        square = part.squares(row, x[active], size)
        promised = (pull * np.linalg.solve(curved, pull[:, :, None])[:, :, 0]).sum(axis=1)
        owed = owes(square, promised, part.dof)
        left[active] = owed
        moving = owed & (damping[active] < _STUCK)
        if not moving.any():
            break
        if moving.mean() < _FEWER:
            active, part, square = active[moving], take_some(part, moving), square[moving]
            curved, pull, width = curved[moving], pull[moving], part.rotation.shape[2]
            row, by_x = row[moving], by_x[moving, :width]
        diagonal = damping[active, None] * np.diagonal(curved, axis1=1, axis2=2)
        damped = curved + diagonal[:, :, None] * np.eye(curved.shape[1])
        step = np.linalg.solve(damped, pull[:, :, None])[:, :, 0]
        off, by_tried = part.predictor.by_starts(parameters, x[active] + step)
        tried = part.rotate_error(off)
        gained = square - part.squares(tried, x[active] + step, size)
        expected = (step * (pull + diagonal * step)).sum(axis=1)
        better = gained > 0.0
        x[active[better]] += step[better]
        row = np.where(better[:, None], tried, row)
        by_x = np.where(better[:, None, None], by_tried, by_x)
        # Nielsen (1999): damping by how well the last step kept its promise
        kept = np.clip(gained / np.maximum(expected, 1e-300), 0.0, 1.0)
        softer = np.maximum(1.0 / 3.0, 1.0 - (2.0 * kept - 1.0) ** 3)
        damping[active] *= np.where(better, softer, harder[active])
        harder[active] = np.where(better, 2.0, 2.0 * harder[active])
    return x, left


def owes(square: Array, promised: Array, dof: Array) -> Mask:
    """(W,) whether windows' losses would fall by more than `OWED` with squares so much smaller."""
    return np.asarray(loss_of(square, dof) - loss_of(square - promised, dof) > OWED)
