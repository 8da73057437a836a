"""What a quantity of a sweep may be: a list, which is crossed with the others, or a distribution.

A draw depends on the seed and the quantity's name alone: another quantity, another list or another
number of seeds changes none of it, and the same seed meets every combination of the lists with the
same draws, so that combinations are compared pair by pair.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, isfinite, log
from typing import Any, Literal
from zlib import crc32

import numpy as np

from steerd.daemon.common.errors import did_you_mean

_STREAM = 23
"""Keeps these numbers apart from those of the simulated instruments' noise."""
_REDRAWS = 1000
"""Draws outside the bounds that are thrown away, before a distribution counts as impossible."""
Shape = Literal["uniform", "log_uniform", "normal", "log_normal"]
_FORMS = (
    "a list, { low, high }, { low, high, log = true }, { mean, sd }, { median, factor } "
    "or { share }"
)
_KEYS = {
    ("high", "low"): "uniform",
    ("high", "log", "low"): "log_uniform",
    ("mean", "sd"): "normal",
    ("factor", "median"): "log_normal",
    ("share",): "normal",
}


@dataclass(frozen=True)
class Distribution:
    """A distribution that is cut at bounds.

    Attributes:
        shape: `uniform` between one and other; `log_uniform`; `normal` with mean `one` and standard
            deviation `other`; `log_normal` with median `one` and factor `other`.
        one, other: see `shape`.
        low, high: no draw lies outside.
    """

    shape: Shape
    one: float
    other: float
    low: float
    high: float

    def draw(self, name: str, seed: int) -> float:
        """The value of a seed.

        Raises:
            ValueError: nearly everything lies outside the bounds.
        """
        rng = np.random.default_rng([_STREAM, crc32(name.encode()), seed])
        for _ in range(_REDRAWS):
            value = self._sample(rng)
            if self.low <= value <= self.high:
                return value
        raise ValueError(f"{name}: nothing between {self.low:g} and {self.high:g} is ever drawn")

    def _sample(self, rng: np.random.Generator) -> float:
        one, other = self.one, self.other
        match self.shape:
            case "uniform":
                return float(rng.uniform(one, other))
            case "log_uniform":
                return exp(rng.uniform(log(one), log(other)))
            case "normal":
                return float(rng.normal(one, other))
            case _:
                return one * exp(log(other) * rng.standard_normal())


def parse_distribution(
    name: str, given: Mapping[str, Any], low: float, high: float, usual: float | None
) -> Distribution:
    """A distribution as a TOML table or a dictionary says it.

    Args:
        name: of the quantity, for messages.
        given: `low` and `high`, also with `log`; `mean` and `sd`; `median` and `factor`; `share` of
            the usual value as a standard deviation.
        low: bound of the quantity.
        high: the other one.
        usual: its value in the car file; None where it has none.

    Raises:
        ValueError: it is none of these, or lies outside the bounds.
    """
    keys = tuple(sorted(given))
    if keys not in _KEYS:
        known = {key for form in _KEYS for key in form}
        odd = next((key for key in keys if key not in known), "")
        hint = did_you_mean(odd, known) if odd else ""
        raise ValueError(f"{name}: {hint or f'give {_FORMS}'}")
    shape = _KEYS[keys]
    if shape == "log_uniform" and given["log"] is not True:
        shape = "uniform"
    numbers = {key: _number(name, key, given[key]) for key in keys if key != "log"}
    one, other = _pair(name, numbers, usual)
    if shape.startswith("log") and not (one > 0.0 and other > 0.0):
        raise ValueError(f"{name}: a logarithm needs positive numbers")
    if "low" in numbers and not one < other:
        raise ValueError(f"{name}: low {one:g} is not below high {other:g}")
    for value in (one, other) if "low" in numbers else (one,):
        check_bounds(name, value, low, high)
    return Distribution(shape, one, other, low, high)  # type: ignore[arg-type]


def _pair(name: str, numbers: Mapping[str, float], usual: float | None) -> tuple[float, float]:
    """The two numbers of a distribution, in the order of `Distribution`."""
    if "share" not in numbers:
        first, second = next(
            (a, b)
            for a, b in (("low", "high"), ("mean", "sd"), ("median", "factor"))
            if a in numbers
        )
        pair = numbers[first], numbers[second]
    elif not usual:
        raise ValueError(f"{name}: no value of which a share could be taken: give mean and sd")
    else:
        pair = usual, abs(usual) * numbers["share"]
    if "low" not in numbers and not pair[1] > 0.0:
        raise ValueError(f"{name}: a spread of {pair[1]:g}: more than 0")
    return pair


def _number(name: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f"{name}: {key} must be a number, not {value!r}")
    return float(value)


def check_bounds(name: str, value: Any, low: float, high: float) -> float:
    """A number within its bounds.

    Raises:
        ValueError: it is none, or lies outside.
    """
    number = _number(name, "the value", value)
    if not low <= number <= high:
        raise ValueError(f"{name} = {number:g}: {low:g} to {high:g}")
    return number


def is_list(given: Any) -> bool:
    """Whether a quantity is given as a list of values."""
    return isinstance(given, Sequence) and not isinstance(given, str)
