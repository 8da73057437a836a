"""The paper's own baseline: CMA-ES through Optuna."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.paper.paper_method import (
    HIGH,
    LOW,
    PaperProblem,
    Watch,
    loss_value,
    never_stop,
    one_thread,
)
from steerd.sysid.paper.search_history import NAMES, BaselineMissingError, SearchHistory

Array = NDArray[np.float64]

CMA_SIGMA = 3.0
"""First spread, as in the paper's authors' experiments."""
LENGTH_SCALE = 28.57
"""They search lengths times this, so that all four parameters lie between 2 and 10."""
SCALE = np.array([LENGTH_SCALE, LENGTH_SCALE, 1.0, 1.0])


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
    first = dict(zip(NAMES, (start * SCALE).tolist(), strict=True))
    with warnings.catch_warnings():
        # Optuna announces that its CMA-ES will move; start and spread are the paper's.
        warnings.simplefilter("ignore", FutureWarning)
        sampler = optuna.samplers.CmaEsSampler(x0=first, sigma0=CMA_SIGMA, seed=seed)
    study = optuna.create_study(sampler=sampler, direction="minimize")
    losses: list[float] = []
    path = [np.array(start, float)]

    def try_once(trial: Any) -> float:
        bounds = zip(NAMES, LOW * SCALE, HIGH * SCALE, strict=True)
        four = np.array([trial.suggest_float(name, a, b) for name, a, b in bounds]) / SCALE
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
