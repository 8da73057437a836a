"""SciPy's least squares on the paper's problem: the obvious method, to compare with."""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from steerd.sysid.paper import SearchHistory
from steerd.sysid.paper.paper_method import SCALE, PaperProblem, one_thread, predict

Array = NDArray[np.float64]

EVERY = 50
"""Positions are compared every 0.1 s."""


@one_thread()
def fit_least_squares(
    problem: PaperProblem, start: Array, watch: Callable[[int, Array, float], object]
) -> SearchHistory:
    """SciPy's trust region on positions of whole runs, derivatives by differences.

    `watch` gets each evaluation's number, the best parameters so far and the loss.

    Time-aligned residuals from known starts: the obvious method.
    """
    from scipy.optimize import least_squares

    losses: list[float] = []
    path: list[Array] = [np.array(start, float)]
    driven = np.concatenate([run.path[::EVERY].ravel() for run in problem.runs])

    def residuals(scaled: Array) -> Array:
        four = scaled / SCALE
        with torch.no_grad():
            paths = predict(problem, torch.from_numpy(four), problem.runs)
        seen = np.concatenate([p[::EVERY].numpy().ravel() for p in paths])
        error = np.nan_to_num(seen - driven, nan=1e3, posinf=1e3, neginf=-1e3)
        losses.append(float(error @ error) / len(error))
        path.append(four)
        watch(len(losses) - 1, path[1 + int(np.argmin(losses))], losses[-1])
        return np.asarray(error, float)

    bounds = (np.array([0.02, 0.02, 0.5, 0.5]) * SCALE, np.array([1.0, 1.0, 40.0, 40.0]) * SCALE)
    result = least_squares(residuals, start * SCALE, bounds=bounds, method="trf")
    final: Array = result.x / SCALE
    return SearchHistory(np.array(losses), np.array(path), np.asarray(final, float))
