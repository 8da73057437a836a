"""The few functions that the vehicle equations need, as a protocol over the number type.

Everything else in the equations is arithmetic, which Python's operators already do for every
number type that we use.
"""

import math
from typing import Any, Protocol, TypeVar


class Scalar(Protocol):
    """A number: float, 0-d or batched tensor, NumPy array, recorded number."""

    def __add__(self, other: Any, /) -> Any: ...
    def __radd__(self, other: Any, /) -> Any: ...
    def __sub__(self, other: Any, /) -> Any: ...
    def __rsub__(self, other: Any, /) -> Any: ...
    def __mul__(self, other: Any, /) -> Any: ...
    def __rmul__(self, other: Any, /) -> Any: ...
    def __truediv__(self, other: Any, /) -> Any: ...
    def __rtruediv__(self, other: Any, /) -> Any: ...
    def __neg__(self) -> Any: ...


T = TypeVar("T", bound=Scalar)


class Ops(Protocol[T]):
    """Elementary functions over one number type.

    `where_positive(condition, then, otherwise)` selects by the sign of `condition` (strictly
    positive selects `then`); implementations evaluate both branches where they must (tensors), so
    callers keep the unselected branch finite.
    """

    def sin(self, a: T, /) -> T: ...
    def cos(self, a: T, /) -> T: ...
    def tan(self, a: T, /) -> T: ...
    def atan(self, a: T, /) -> T: ...
    def tanh(self, a: T, /) -> T: ...
    def exp(self, a: T, /) -> T: ...
    def sqrt(self, a: T, /) -> T: ...
    def absolute(self, a: T, /) -> T: ...
    def minimum(self, a: T, b: T | float, /) -> T: ...
    def maximum(self, a: T, b: T | float, /) -> T: ...
    def clip(self, a: T, low: T | float, high: T | float, /) -> T: ...
    def where_positive(self, condition: T, then: T | float, otherwise: T | float, /) -> T: ...


class FloatOps:
    """`Ops` over Python floats (the C library's functions)."""

    sin, cos, tan, atan = map(staticmethod, (math.sin, math.cos, math.tan, math.atan))
    tanh, exp, sqrt, absolute = map(staticmethod, (math.tanh, math.exp, math.sqrt, math.fabs))

    @staticmethod
    def minimum(a: float, b: float, /) -> float:
        """The smaller of the two."""
        return a if a < b else b

    @staticmethod
    def maximum(a: float, b: float, /) -> float:
        """The larger of the two."""
        return a if a > b else b

    @staticmethod
    def clip(a: float, low: float, high: float, /) -> float:
        """`a` kept within [low, high]."""
        if a < low:
            return low
        return high if a > high else a

    @staticmethod
    def where_positive(condition: float, then: float, otherwise: float, /) -> float:
        """`then` where the condition is strictly positive."""
        return then if condition > 0.0 else otherwise


FLOAT: Ops[float] = FloatOps()
