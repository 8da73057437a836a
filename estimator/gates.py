"""The gate of a measurement: a quantile of the chi-square distribution."""

from functools import lru_cache
from math import erfc, exp, gamma, sqrt

_HALVINGS = 80


def chi_square_above(degrees: int, x: float) -> float:
    """Probability that a chi-square variable of so many degrees of freedom is larger than `x`."""
    found, k = (erfc(sqrt(0.5 * x)), 1) if degrees % 2 else (exp(-0.5 * x), 2)
    while k < degrees:
        found += (0.5 * x) ** (0.5 * k) * exp(-0.5 * x) / gamma(0.5 * k + 1.0)
        k += 2
    return found


@lru_cache(maxsize=64)
def chi_square_gate(degrees: int, probability: float) -> float:
    """What a chi-square variable stays below with a probability, by bisection."""
    low, high = 0.0, 1.0
    while chi_square_above(degrees, high) > 1.0 - probability:
        high *= 2.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if chi_square_above(degrees, middle) > 1.0 - probability:
            low = middle
        else:
            high = middle
    return high
