"""What a sweep may vary: the drive, the simulated car, its effects, its instruments.

`path`, `speed`, `car.NAME` (a parameter of the simulated car), `effect.NAME` or
`effect.NAME.PARAMETER`, and the noise and delay of mocap and VESC.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, isfinite, log
from typing import Any, Literal, NamedTuple
from zlib import crc32

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.effects import find_effect
from steerd.car_model.params import PARAMETERS
from steerd.daemon.common.errors import did_you_mean
from steerd.sim_hw.mocap.cameras import MocapConfig
from steerd.sim_hw.vesc.vesc_motor import VescConfig


class Quantity(NamedTuple):
    """One thing that may be varied."""

    name: str  # as a sweep file says it
    low: float  # bounds, this and the next
    high: float
    unit: str  # SI, `1` for none; empty for a text
    meaning: str  # one line
    # The car file's or the simulator's own value; None where there is none
    usual: float | None = None

    @property
    def is_text(self) -> bool:
        """Whether its values are texts."""
        return not self.unit


_MOCAP, _VESC = MocapConfig(), VescConfig()
_INSTRUMENTS = (
    Quantity("mocap.position_noise", 0.0, 0.05, "m", "mocap: noise of a position",
             _MOCAP.position_noise),
    Quantity("mocap.yaw_noise", 0.0, 0.2, "rad", "mocap: noise of a heading", _MOCAP.yaw_noise),
    Quantity("mocap.latency", 0.0, 0.05, "s", "mocap: exposure to transmission",
             (_MOCAP.camera_ns + _MOCAP.software_ns) * 1e-9),
    Quantity("mocap.jitter", 0.0, 0.005, "s", "mocap: spread of the transmission",
             _MOCAP.jitter_ns * 1e-9),
    Quantity("vesc.erpm_noise", 0.0, 500.0, "ERPM", "VESC: noise of the reported ERPM",
             _VESC.erpm_noise),
    Quantity("vesc.gyro_noise", 0.0, 0.5, "rad/s", "VESC: noise of the gyro", _VESC.gyro_noise),
    Quantity("vesc.reply_delay", 0.0, 0.005, "s", "VESC: request to reply",
             _VESC.reply_delay_ns * 1e-9),
)  # fmt: skip
_DRIVE = (
    Quantity("path", 0.0, 0.0, "", "path, as --path takes it"),
    Quantity("speed", 0.05, 20.0, "m/s", "speed on straights", 1.0),
)


def find_quantity(name: str, car: CarFile) -> Quantity:
    """The quantity of a name.

    Raises:
        ValueError: there is none; the message offers the nearest.
    """
    for quantity in (*_DRIVE, *_INSTRUMENTS):
        if quantity.name == name:
            return quantity
    kind, _, rest = name.partition(".")
    if kind == "car":
        for p in PARAMETERS:
            if p.name == rest:
                usual = float(getattr(car.car, rest))
                return Quantity(name, p.low, p.high, p.unit, p.meaning, usual)
    if kind == "effect" and rest:
        return _find_effect(name, rest)
    raise ValueError(f"nothing is called {name!r}; {_hint(name)}")


def _find_effect(name: str, rest: str) -> Quantity:
    effect_name, _, wanted = rest.partition(".")
    effect = find_effect(effect_name)
    parameters = {p.name: p for p in effect.parameters}
    if not wanted and len(parameters) > 1:
        raise ValueError(f"{name}: which of {', '.join(parameters)}? effect.{effect.name}.NAME")
    chosen = parameters.get(wanted) if wanted else effect.parameters[0]
    if chosen is None:
        raise ValueError(f"{effect.name} has no {wanted!r}, but {', '.join(parameters)}")
    return Quantity(name, chosen.low, chosen.high, chosen.unit, chosen.meaning, chosen.null)


def _hint(name: str) -> str:
    known = [q.name for q in (*_DRIVE, *_INSTRUMENTS)] + [f"car.{p.name}" for p in PARAMETERS]
    more = "a sweep varies path, speed, car.NAME, effect.NAME, mocap.… and vesc.…"
    return did_you_mean(name, known) or more


_STREAM = 23
"""Keeps these numbers apart from those of the simulated instruments' noise."""
_REDRAWS = 1000
"""Draws outside the bounds that are thrown away, before a distribution counts as impossible."""
Shape = Literal["uniform", "log_uniform", "normal", "log_normal"]
_FORMS = (
    "a list, { low, high }, { low, high, log = true }, { mean, sd }, { median, factor } "
    "or { share }"
)
_KEYS: Mapping[Shape, tuple[str, str]] = {
    "uniform": ("low", "high"), "normal": ("mean", "sd"), "log_normal": ("median", "factor"),
}  # fmt: skip
"""The two numbers of a distribution, as a sweep file calls them."""


@dataclass(frozen=True)
class Distribution:
    """A distribution that is cut at bounds."""

    shape: Shape
    one: float  # lower end of (log_)uniform, mean of normal, median of log_normal
    other: float  # upper end; standard deviation; factor
    low: float  # no draw lies outside `low` and `high`
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


def parse_distribution(quantity: Quantity, given: Mapping[str, Any]) -> Distribution:
    """A distribution as a TOML table or a dictionary says it.

    Args:
        quantity: what is drawn.
        given: `low` and `high`, also with `log`; `mean` and `sd`; `median` and `factor`; `share` of
            the usual value as a standard deviation.

    Raises:
        ValueError: it is none of these, or lies outside the bounds.
    """
    name, rest, shape = quantity.name, dict(given), _find_shape(quantity.name, given)
    log = rest.pop("log", False) is True
    if "share" in rest:
        if not quantity.usual:
            what = f"{name}: no value of which a share could be taken: give mean and sd"
            raise ValueError(what)
        share = _number(name, "share", rest["share"])
        rest = {"mean": quantity.usual, "sd": abs(quantity.usual) * share}
    one, other = (_number(name, key, rest[key]) for key in _KEYS[shape])
    uniform = shape == "uniform"
    if (log or shape == "log_normal") and not (one > 0.0 and other > 0.0):
        raise ValueError(f"{name}: a logarithm needs positive numbers")
    if uniform and not one < other:
        raise ValueError(f"{name}: low {one:g} is not below high {other:g}")
    if not uniform and not other > 0.0:
        raise ValueError(f"{name}: a spread of {other:g}: more than 0")
    for value in (one, other) if uniform else (one,):
        check_bounds(name, value, quantity.low, quantity.high)
    shape = "log_uniform" if log else shape
    return Distribution(shape, one, other, quantity.low, quantity.high)


def _find_shape(name: str, given: Mapping[str, Any]) -> Shape:
    """The distribution that has these numbers; a share is a normal one's.

    Raises:
        ValueError: none has.
    """
    found = {frozenset(keys): shape for shape, keys in _KEYS.items()}
    found |= {frozenset(("low", "high", "log")): "uniform", frozenset(("share",)): "normal"}
    shape = found.get(frozenset(given))
    if shape is None:
        known = set().union(*found)
        odd = next((key for key in sorted(given) if key not in known), "")
        hint = did_you_mean(odd, known) if odd else ""
        raise ValueError(f"{name}: {hint or f'give {_FORMS}'}")
    return shape


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
