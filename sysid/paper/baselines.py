"""Baselines: CMA-ES through Optuna (the paper's own) and SciPy's least squares."""

import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from steerd.sysid.paper.paper_method import (
    HIGH,
    LOW,
    PaperProblem,
    Watch,
    loss_value,
    never_stop,
    one_thread,
    predict,
)
from steerd.sysid.paper.search_history import NAMES, BaselineMissingError, SearchHistory

Array = NDArray[np.float64]

CMA_SIGMA = 3.0
"""First spread, as in the paper's authors' experiments."""
LENGTH_SCALE = 28.57
"""They search lengths times this, so that all four parameters lie between 2 and 10."""
_SCALE = np.array([LENGTH_SCALE, LENGTH_SCALE, 1.0, 1.0])
EVERY = 50
"""Least squares compares positions every 0.1 s."""


def _optuna() -> Any:
    try:
        import cmaes as _cmaes  # type: ignore[import-untyped]  # noqa: F401
        import optuna
    except ImportError as error:
        text = "CMA-ES needs Optuna: pip install optuna cmaes"
        raise BaselineMissingError(text) from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


@one_thread()
def search_cma(
    problem: PaperProblem, start: Array, trials: int = 500, seed: int = 0, watch: Watch = never_stop
) -> SearchHistory:
    """CMA-ES on the paper's loss, one batch a trial.

    Raises:
        BaselineMissingError: Optuna is not installed.
    """
    optuna = _optuna()
    first = dict(zip(NAMES, (start * _SCALE).tolist(), strict=True))
    with warnings.catch_warnings():
        # Optuna announces that its CMA-ES will move; start and spread are the paper's.
        warnings.simplefilter("ignore", FutureWarning)
        sampler = optuna.samplers.CmaEsSampler(x0=first, sigma0=CMA_SIGMA, seed=seed)
    study = optuna.create_study(sampler=sampler, direction="minimize")
    losses: list[float] = []
    path = [np.array(start, float)]

    def try_once(trial: Any) -> float:
        bounds = zip(NAMES, LOW * _SCALE, HIGH * _SCALE, strict=True)
        four = np.array([trial.suggest_float(name, a, b) for name, a, b in bounds]) / _SCALE
        loss = loss_value(problem, four, len(losses))
        losses.append(loss)
        path.append(four)
        best = path[1 + int(np.argmin(losses))]
        if watch(len(losses) - 1, best, loss):
            study.stop()
        return loss

    study.optimize(try_once, n_trials=trials)
    final = path[1 + int(np.argmin(losses))]
    return SearchHistory(
        np.array(start, float), np.array(losses), np.array(path), np.asarray(final, float)
    )


@one_thread()
def fit_least_squares(
    problem: PaperProblem, start: Array, watch: Watch = never_stop
) -> SearchHistory:
    """SciPy's trust region on positions of whole runs, derivatives by differences.

    Time-aligned residuals from known starts: the obvious method.
    """
    from scipy.optimize import least_squares

    losses: list[float] = []
    path: list[Array] = [np.array(start, float)]
    driven = np.concatenate([run.path[::EVERY].ravel() for run in problem.runs])

    def residuals(scaled: Array) -> Array:
        four = scaled / _SCALE
        with torch.no_grad():
            paths = predict(problem, torch.from_numpy(four), problem.runs)
        seen = np.concatenate([p[::EVERY].numpy().ravel() for p in paths])
        error = np.nan_to_num(seen - driven, nan=1e3, posinf=1e3, neginf=-1e3)
        losses.append(float(error @ error) / len(error))
        path.append(four)
        watch(len(losses) - 1, path[1 + int(np.argmin(losses))], losses[-1])
        return np.asarray(error, float)

    bounds = (np.array([0.02, 0.02, 0.5, 0.5]) * _SCALE, np.array([1.0, 1.0, 40.0, 40.0]) * _SCALE)
    result = least_squares(residuals, start * _SCALE, bounds=bounds, method="trf")
    final: Array = result.x / _SCALE
    return SearchHistory(
        np.array(start, float), np.array(losses), np.array(path), np.asarray(final, float)
    )
