"""History of a search by the paper's methods; needs no torch."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES: tuple[str, ...] = ("lf", "lr", "c_sf", "c_sr")
"""Parameters that the paper identifies."""


class BaselineMissingError(ImportError):
    """The optional extra `baselines` is not installed."""


class SearchHistory(NamedTuple):
    """History of one start."""

    start: Array  # (4,) in the order of `NAMES`
    losses: Array  # loss of each iteration's batch
    path: Array  # (iterations + 1, 4) parameters
    final: Array  # (4,) the last ones (Adam), or the best (CMA-ES)
    diverged: bool = False  # a loss was not finite, which ended it
