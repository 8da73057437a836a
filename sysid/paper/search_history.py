"""History of a search by the paper's methods; needs no torch."""

from typing import NamedTuple

from steerd.sysid.data.data_checks import Array

NAMES: tuple[str, ...] = ("lf", "lr", "c_sf", "c_sr")
"""Parameters that the paper identifies."""


class BaselineMissingError(ImportError):
    """The optional extra `baselines` is not installed."""


class SearchHistory(NamedTuple):
    """History of one start."""

    losses: Array  # loss of each iteration's batch
    path: Array  # (iterations + 1, 4) parameters in the order of `NAMES`, from the start on
    final: Array  # (4,) the last ones (Adam), or the best (CMA-ES)
    diverged: bool = False  # a loss was not finite, which ended it
