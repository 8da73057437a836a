"""Elementary functions that LLVM can vectorise: no branches, no calls into libm.

Numba's libm calls keep a loop scalar; sine and cosine took more than half of a step. Each
function here is polynomials and selects, good to a few units in the last place over the range that
a car's equations use (angles up to 1e5 rad). Coefficients: Cephes library (S. Moshier), the classic
minimax fits; range reduction after Cody and Waite.
"""

from math import sqrt as _sqrt
from typing import Any

import numba
import numpy as np

from steerd.sysid.compiler.choice import select

inline = numba.njit(error_model="numpy", fastmath={"contract", "nsz"}, inline="never")

_TWO_OVER_PI = 2.0 / np.pi
# pi/2 in three parts whose products with a small integer are exact (Cephes DP1..DP3, doubled).
_HALF_PI_1 = 1.57079625129699707031
_HALF_PI_2 = 7.54978941586159635336e-8
_HALF_PI_3 = 5.39030285815811905290e-15


@inline
def _sin_kernel(r: float) -> float:
    z = r * r
    p = 1.58962301576546568060e-10
    p = p * z - 2.50507477628578072866e-8
    p = p * z + 2.75573136213857245213e-6
    p = p * z - 1.98412698295895385996e-4
    p = p * z + 8.33333333332211858878e-3
    p = p * z - 1.66666666666666307295e-1
    return r + r * z * p


@inline
def _cos_kernel(r: float) -> float:
    z = r * r
    p = -1.13585365213876817300e-11
    p = p * z + 2.08757008419747316778e-9
    p = p * z - 2.75573141792967388112e-7
    p = p * z + 2.48015872888517045348e-5
    p = p * z - 1.38888888888730564116e-3
    p = p * z + 4.16666666666665929218e-2
    return 1.0 - 0.5 * z + z * z * p


@inline
def _sin_shifted(x: float, quarter: float) -> Any:
    # sin(x + quarter * pi/2)
    n = np.floor(x * _TWO_OVER_PI + 0.5)
    r = ((x - n * _HALF_PI_1) - n * _HALF_PI_2) - n * _HALF_PI_3
    n = n + quarter
    n = n - 4.0 * np.floor(0.25 * n)
    odd = n - 2.0 * np.floor(0.5 * n)
    size = select(odd - 0.5, _cos_kernel(r), _sin_kernel(r))
    return select(n - 1.5, -size, size)


@inline
def sin(x: float) -> Any:
    """Sine of an angle [rad]."""
    return _sin_shifted(x, 0.0)


@inline
def cos(x: float) -> Any:
    """Cosine of an angle [rad]."""
    return _sin_shifted(x, 1.0)


@inline
def tan(x: float) -> Any:
    """Tangent of an angle [rad]."""
    n = np.floor(x * _TWO_OVER_PI + 0.5)
    r = ((x - n * _HALF_PI_1) - n * _HALF_PI_2) - n * _HALF_PI_3
    odd = n - 2.0 * np.floor(0.5 * n)
    s, c = _sin_kernel(r), _cos_kernel(r)
    return select(odd - 0.5, -c, s) / select(odd - 0.5, s, c)


@inline
def atan(x: float) -> Any:
    """Arc tangent [rad] (Cephes atan)."""
    a = np.fabs(x)
    steep, middle = a - 2.41421356237309504880, a - 0.66
    base = select(steep, 0.5 * np.pi, select(middle, 0.25 * np.pi, 0.0))
    u = select(steep, -1.0, select(middle, a - 1.0, a))
    u = u / select(steep, a, select(middle, a + 1.0, 1.0))
    z = u * u
    p = -8.750608600031904122785e-1
    p = p * z - 1.615753718733365076637e1
    p = p * z - 7.500855792314704667340e1
    p = p * z - 1.228866684490136173410e2
    p = p * z - 6.485021904942025371773e1
    q = z + 2.485846490142306297962e1
    q = q * z + 1.650270098316988542046e2
    q = q * z + 4.328810604912902668951e2
    q = q * z + 4.853903996359136964868e2
    q = q * z + 1.945506571482613964425e2
    size = base + (u * (z * p / q) + u)
    return select(x, size, -size)


@inline
def sqrt(x: float) -> float:
    """Square root."""
    return _sqrt(x)


@inline
def exp(x: float) -> Any:
    """Exponential (libm's: only effects with memory need it inside a loop)."""
    return np.exp(x)


@inline
def tanh(x: float) -> Any:
    """Hyperbolic tangent (libm's)."""
    return np.tanh(x)


@inline
def abs(x: float) -> Any:
    """Magnitude."""
    return np.fabs(x)
