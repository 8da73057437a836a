"""`Ops` over NumPy arrays: many cars side by side, one array element each."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.ops import Ops

Array = NDArray[np.float64]


class NumpyOps:
    """`Ops` over float64 arrays that broadcast against each other."""

    sin, cos, tan, atan = map(staticmethod, (np.sin, np.cos, np.tan, np.arctan))
    tanh, exp, sqrt, absolute = map(staticmethod, (np.tanh, np.exp, np.sqrt, np.absolute))
    minimum, maximum = map(staticmethod, (np.minimum, np.maximum))

    @staticmethod
    def clip(a: Array, low: Array | float, high: Array | float, /) -> Array:
        """`a` kept within [low, high]."""
        kept: Array = np.minimum(np.maximum(a, low), high)
        return kept

    @staticmethod
    def where_positive(condition: Array, then: Array | float, otherwise: Array | float, /) -> Array:
        """`then` where the condition is strictly positive."""
        return np.where(condition > 0.0, then, otherwise)


NUMPY: Ops[Any] = NumpyOps()
