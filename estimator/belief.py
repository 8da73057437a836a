"""What a filter believes: a Gaussian about the car's state."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Belief(NamedTuple):
    """A Gaussian belief about the state. Never changed in place."""

    mean: Array
    """(n,), in the order of `steerd.car_model.state.State`."""
    covariance: Array
    """(n, n), symmetric."""
