"""The method of the IROS 2023 paper and other baselines, for comparison.

Torch lives in `paper_method`; what needs none is here: car, parameters, a search's history.
"""

from typing import NamedTuple

from steerd.car_model.params import PAPER_CAR, Car
from steerd.sysid.data.data_checks import Array

NAMES: tuple[str, ...] = ("lf", "lr", "c_sf", "c_sr")  # parameters that the paper identifies

PAPER_CAR_DIRECT: Car[float] = PAPER_CAR._replace(
    steer_delay=0.0, steer_lag=0.0, steer_rate=1e3, speed_lag=0.0, accel_max=1e3, decel_max=1e3
)
"""The paper's car (7 states, steering clipped at +-0.34 rad) with actuators that follow at once."""


class SearchHistory(NamedTuple):
    """History of one start."""

    losses: Array  # loss of each iteration's batch
    path: Array  # (iterations + 1, 4) parameters in the order of `NAMES`, from the start on
    final: Array  # (4,) the last ones (Adam), or the best (CMA-ES)
    diverged: bool = False  # a loss was not finite, which ended it
