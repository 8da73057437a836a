"""What the paper's methods tell of a start, without the torch that they need."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES: tuple[str, ...] = ("lf", "lr", "c_sf", "c_sr")
"""What the paper identifies."""


class BaselineMissingError(ImportError):
    """The optional extra `baselines` is not installed."""


class SearchHistory(NamedTuple):
    """How one start went.

    Attributes:
        start: (4,) in the order of `NAMES`.
        losses: loss of each iteration's batch.
        path: (iterations + 1, 4) parameters.
        final: (4,) the last ones (Adam), or the best (CMA-ES).
        diverged: a loss was not finite, which ended it.
    """

    start: Array
    losses: Array
    path: Array
    final: Array
    diverged: bool = False
