"""A sweep: what is varied, over which seeds, and the drives that follow from it.

A sweep file is TOML:

    seeds = 1000                  # or a list of them
    duration = 20.0               # of each drive [s]
    car = "car.toml"              # what the controller is designed from

    [vary]                        # of the simulated car and its drive
    path = ["figure8", "circle:radius=2"]
    speed = { low = 1.0, high = 2.0 }
    "car.mass" = { share = 0.05 }
    "effect.steer_delay" = { low = 0.0, high = 0.04 }
    "mocap.position_noise" = [0.0002, 0.001]
"""

import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import CarFile
from steerd.daemon.common.errors import ExitCode, SteerdError, did_you_mean
from steerd.daemon.many.sweep.quantities import (
    Distribution,
    Quantity,
    check_bounds,
    find_quantity,
    is_list,
    parse_distribution,
)
from steerd.toml_text import TomlError, load_toml

DURATION_MAX = 3600.0
"""Longest drive of a sweep [s]."""
DRIVES_MAX = 1_000_000
"""More drives are a mistake in a list."""
DRIVEN, STOPPED, REFUSED = "driven", "stopped", "refused"
"""How a drive ended: as planned, by a watchdog, or before it began."""
Value = float | str
Choice = tuple[Value, ...] | Distribution


@dataclass(frozen=True)
class SweepPlan:
    """A sweep that can be driven."""

    car: CarFile  # what the controller is designed from, and the simulated car unless varied
    seeds: tuple[int, ...] = tuple(range(100))  # of draws and of the simulated hardware's noise
    duration: float = 20.0  # of a drive [s]
    rate: float = 100.0  # of the loop [Hz]
    path: str = "figure8"  # of all drives, unless varied
    speed: float = 1.0  # of all drives, unless varied [m/s]
    # Values or a distribution by the quantity's name
    vary: Mapping[str, Choice] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of drives."""
        total = len(self.seeds)
        for choice in self.vary.values():
            total *= len(choice) if isinstance(choice, tuple) else 1
        return total

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What is varied."""
        return tuple(find_quantity(name, self.car) for name in self.vary)

    def digest(self) -> str:
        """What the drives' results depend on, beside the program itself."""
        choices = {
            name: asdict(choice) if isinstance(choice, Distribution) else list(choice)
            for name, choice in self.vary.items()
        }
        rest = [self.car.text, self.seeds, self.duration, self.rate, self.path, self.speed]
        text = json.dumps([choices, *rest])
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class DriveCase:
    """One drive of a sweep."""

    number: int  # from 0, in the order of the table
    seed: int  # of the simulated hardware's noise
    values: Mapping[str, Value]  # of what is varied


def list_cases(plan: SweepPlan) -> Iterator[DriveCase]:
    """Every combination of the lists, each with every seed.

    Raises:
        SteerdError: a distribution never yields what its quantity may be.
    """
    lists = {name: c for name, c in plan.vary.items() if isinstance(c, tuple)}
    drawn = {name: c for name, c in plan.vary.items() if isinstance(c, Distribution)}
    number = itertools.count()
    for combination in itertools.product(*lists.values()):
        fixed = dict(zip(lists, combination, strict=True))
        for seed in plan.seeds:
            values = {name: _draw(drawn, name, seed, fixed) for name in plan.vary}
            yield DriveCase(next(number), seed, values)


def _draw(
    drawn: Mapping[str, Distribution], name: str, seed: int, fixed: Mapping[str, Value]
) -> Value:
    if name in fixed:
        return fixed[name]
    try:
        return drawn[name].draw(name, seed)
    except ValueError as error:
        raise SteerdError(str(error), "", ExitCode.USAGE) from None


def read_sweep_file(path: Path) -> dict[str, Any]:
    """The tables of a sweep file.

    Raises:
        SteerdError: it cannot be read, or is no TOML.
    """
    try:
        return load_toml(path)
    except OSError as error:
        raise SteerdError(f"{path}: {error.strerror}", "", ExitCode.UNREADABLE) from None
    except TomlError as error:
        raise SteerdError(f"{path}: {error}", "", ExitCode.INVALID) from None


def make_sweep_plan(car: CarFile, given: Mapping[str, Any]) -> SweepPlan:
    """Check what a sweep file or a caller says.

    Args:
        car: the car file.
        given: `seeds`, `duration`, `rate`, `path`, `speed`, `vary`.

    Raises:
        SteerdError: something is unknown, missing or impossible.
    """
    known = (*_PARSERS, "car", "vary")
    odd = next((key for key in given if key not in known), None)
    if odd is not None:
        hint = did_you_mean(odd, known) or f"there are {', '.join(known)}"
        raise SteerdError(f"a sweep has no {odd!r}", hint)
    try:
        vary = {
            name: _parse_choice(find_quantity(name, car), choice)
            for name, choice in dict(given.get("vary", {})).items()
        }
        said = {key: parse(given[key]) for key, parse in _PARSERS.items() if key in given}
    except ValueError as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None
    plan = SweepPlan(car, vary=vary, **said)
    if plan.count > DRIVES_MAX:
        raise SteerdError(f"{plan.count} drives: {DRIVES_MAX} at most", "shorten the lists")
    return plan


def _parse_path(given: Any) -> str:
    if not isinstance(given, str):
        raise ValueError(f"path must be a text such as 'figure8', not {given!r}")
    return given


def _parse_seeds(given: Any) -> tuple[int, ...]:
    """A number of seeds from 0, or a list."""
    if isinstance(given, int) and not isinstance(given, bool) and given > 0:
        return tuple(range(given))
    whole = is_list(given) and all(type(seed) is int and seed >= 0 for seed in given)
    if not (whole and given and len(set(given)) == len(given)):
        raise ValueError("seeds: how many, or a list of different whole numbers from 0")
    return tuple(given)


def _parse_choice(quantity: Quantity, given: Any) -> Choice:
    """A list of values, or a distribution."""
    if isinstance(given, Mapping):
        if quantity.is_text:
            raise ValueError(f"{quantity.name} is a text: give a list")
        return parse_distribution(quantity, given)
    values: Sequence[Any] = given if is_list(given) else [given]
    if not values:
        raise ValueError(f"{quantity.name}: the list is empty")
    if quantity.is_text:
        return tuple(_parse_path(value) for value in values)
    return tuple(check_bounds(quantity.name, v, quantity.low, quantity.high) for v in values)


_PARSERS: Mapping[str, Callable[[Any], Any]] = {
    "seeds": _parse_seeds,
    "duration": lambda given: check_bounds("duration", given, 0.1, DURATION_MAX),
    "rate": lambda given: check_bounds("rate", given, 20.0, 1000.0),
    "path": _parse_path,
    "speed": lambda given: check_bounds("speed", given, 0.05, 20.0),
}
"""What a sweep file may say of all drives, beside the car and what is varied."""
