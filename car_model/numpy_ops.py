"""`Ops` over NumPy arrays: many cars side by side, one array element each."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.ops import Ops

Array = NDArray[np.float64]


class NumpyOps:
    """`Ops` over float64 arrays that broadcast against each other."""

    sin = staticmethod(np.sin)
    cos = staticmethod(np.cos)
    tan = staticmethod(np.tan)
    atan = staticmethod(np.arctan)
    tanh = staticmethod(np.tanh)
    exp = staticmethod(np.exp)
    sqrt = staticmethod(np.sqrt)
    absolute = staticmethod(np.absolute)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)

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
