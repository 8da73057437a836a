"""A sweep: what is varied, over which seeds, and the drives that follow from it.

A sweep file is TOML; `steerd sweep --example` prints one.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from math import exp, isfinite, log, prod
from pathlib import Path
from typing import Any, Literal, NamedTuple
from zlib import crc32

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.effects import find_effect
from steerd.car_model.params import PARAMETERS
from steerd.daemon.analysis.options import read_car
from steerd.daemon.common.errors import ExitCode, SteerdError, did_you_mean, refusing
from steerd.daemon.many.job import make_digest
from steerd.sim_hw.mocap.cameras import MocapConfig
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.toml_text import load_toml


class Quantity(NamedTuple):
    """One thing that may be varied."""

    name: str  # as a sweep file says it
    low: float  # bounds, this and the next
    high: float
    unit: str  # SI, `1` for none; empty for a text
    meaning: str  # one line
    # The car file's or the simulator's own value; None where there is none
    usual: float | None = None
    # Names in the car; an effect and its parameter; in the configuration of an instrument's device,
    # where they sum up and the first one is varied
    fields: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """`car`, `effect`, `mocap`, `vesc`, or the name of what stands alone."""
        return self.name.partition(".")[0]

    @property
    def is_text(self) -> bool:
        """Whether its values are texts."""
        return not self.unit

    def check(self, value: Any) -> float:
        """A number within the bounds; a ValueError for anything else."""
        number = _number(self.name, "the value", value)
        if not self.low <= number <= self.high:
            raise ValueError(f"{self.name} = {number:g}: {self.low:g} to {self.high:g}")
        return number


def _number(name: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f"{name}: {key} must be a number, not {value!r}")
    return float(value)


def _instrument(name: str, high: float, unit: str, meaning: str, *fields: str) -> Quantity:
    config = {"mocap": MocapConfig, "vesc": VescConfig}[name.partition(".")[0]]()
    usual = sum(getattr(config, each) for each in fields)
    usual *= 1e-9 if fields[0].endswith("_ns") else 1.0
    return Quantity(name, 0.0, high, unit, meaning, usual, fields)


INSTRUMENTS = (
    _instrument("mocap.position_noise", 0.05, "m", "mocap: noise of a position", "position_noise"),
    _instrument("mocap.yaw_noise", 0.2, "rad", "mocap: noise of a heading", "yaw_noise"),
    _instrument(
        "mocap.latency", 0.05, "s", "mocap: exposure to transmission", "camera_ns", "software_ns"
    ),
    _instrument("mocap.jitter", 0.005, "s", "mocap: spread of the transmission", "jitter_ns"),
    _instrument("vesc.erpm_noise", 500.0, "ERPM", "VESC: noise of the reported ERPM", "erpm_noise"),
    _instrument("vesc.gyro_noise", 0.5, "rad/s", "VESC: noise of the gyro", "gyro_noise"),
    _instrument("vesc.reply_delay", 0.005, "s", "VESC: request to reply", "reply_delay_ns"),
)
_PATH = Quantity("path", 0.0, 0.0, "", "path, as --path takes it")
_SPEED = Quantity("speed", 0.05, 20.0, "m/s", "speed on straights", 1.0)


def find_quantity(name: str, car: CarFile) -> Quantity:
    """The quantity of a name.

    Raises:
        ValueError: there is none; the message offers the nearest.
    """
    known = {q.name: q for q in (_PATH, _SPEED, *INSTRUMENTS)}
    for p in PARAMETERS:
        usual = float(getattr(car.car, p.name))
        about = p.low, p.high, p.unit, p.meaning, usual, (p.name,)
        known[f"car.{p.name}"] = Quantity(f"car.{p.name}", *about)
    if name in known:
        return known[name]
    kind, _, rest = name.partition(".")
    if kind != "effect" or not rest:
        more = "a sweep varies path, speed, car.NAME, effect.NAME, mocap.… and vesc.…"
        raise ValueError(f"nothing is called {name!r}; {did_you_mean(name, known) or more}")
    effect_name, _, wanted = rest.partition(".")
    effect = find_effect(effect_name)
    parameters = {p.name: p for p in effect.parameters}
    if not wanted and len(parameters) > 1:
        raise ValueError(f"{name}: which of {', '.join(parameters)}? effect.{effect.name}.NAME")
    chosen = parameters.get(wanted) if wanted else effect.parameters[0]
    if chosen is None:
        raise ValueError(f"{effect.name} has no {wanted!r}, but {', '.join(parameters)}")
    fields = effect.name, chosen.name
    return Quantity(name, chosen.low, chosen.high, chosen.unit, chosen.meaning, chosen.null, fields)


_STREAM = 23  # keeps these numbers apart from those of the simulated instruments' noise
_REDRAWS = 1000
"""Draws outside the bounds that are thrown away, before a distribution counts as impossible."""
Shape = Literal["uniform", "log_uniform", "normal", "log_normal"]


class Form(NamedTuple):
    """A kind of distribution of two numbers."""

    keys: tuple[str, ...]  # as a sweep file calls them, the two numbers first
    draw: Callable[[np.random.Generator, float, float], float]
    words: str  # with places for the two


FORMS: Mapping[Shape, Form] = {
    "uniform": Form(("low", "high"), lambda rng, a, b: rng.uniform(a, b), "{} to {}"),
    "log_uniform": Form(
        ("low", "high", "log"), lambda rng, a, b: exp(rng.uniform(log(a), log(b))),
        "{} to {} (logarithmic)",
    ),
    "normal": Form(("mean", "sd"), lambda rng, a, b: rng.normal(a, b), "{} ± {}"),
    "log_normal": Form(
        ("median", "factor"), lambda rng, a, b: a * exp(log(b) * rng.standard_normal()),
        "{}, factor {}",
    ),
}  # fmt: skip
_GIVEN = (
    "a list, { low, high }, { low, high, log = true }, { mean, sd }, { median, factor } "
    "or { share }"
)


@dataclass(frozen=True)
class Distribution:
    """A distribution that is cut at bounds."""

    shape: Shape
    one: float  # lower end of (log_)uniform, mean of normal, median of log_normal
    other: float  # upper end; standard deviation; factor
    low: float  # no draw lies outside `low` and `high`
    high: float

    def __str__(self) -> str:
        return FORMS[self.shape].words.format(f"{self.one:.4g}", f"{self.other:.4g}")

    def draw(self, name: str, seed: int) -> float:
        """The value of a seed.

        Raises:
            ValueError: nearly everything lies outside the bounds.
        """
        rng = np.random.default_rng([_STREAM, crc32(name.encode()), seed])
        for _ in range(_REDRAWS):
            value = float(FORMS[self.shape].draw(rng, self.one, self.other))
            if self.low <= value <= self.high:
                return value
        raise ValueError(f"{name}: nothing between {self.low:g} and {self.high:g} is ever drawn")


def parse_distribution(quantity: Quantity, given: Mapping[str, Any]) -> Distribution:
    """The distribution of a quantity, as a TOML table or a dictionary says it, see `_GIVEN`.

    A `share` of the usual value is a standard deviation.

    Raises:
        ValueError: it is none of these, or lies outside the bounds.
    """
    name, rest, usual = quantity.name, dict(given), quantity.usual
    if [*rest] == ["share"]:
        if not usual:
            raise ValueError(f"{name}: no value of which a share could be taken: give mean and sd")
        rest = {"mean": usual, "sd": abs(usual) * _number(name, "share", rest["share"])}
    shape = next((shape for shape, form in FORMS.items() if {*rest} == {*form.keys}), None)
    if shape is None:
        known = {"share"}.union(*(form.keys for form in FORMS.values()))
        odd = next((key for key in sorted(given) if key not in known), "")
        hint = did_you_mean(odd, known) if odd else ""
        raise ValueError(f"{name}: {hint or f'give {_GIVEN}'}")
    if shape == "log_uniform" and rest["log"] is not True:
        shape = "uniform"
    one, other = (_number(name, key, rest[key]) for key in FORMS[shape].keys[:2])
    two_ends = "low" in rest
    if shape.startswith("log") and not (one > 0.0 and other > 0.0):
        raise ValueError(f"{name}: a logarithm needs positive numbers")
    if two_ends and not one < other:
        raise ValueError(f"{name}: low {one:g} is not below high {other:g}")
    if not two_ends and not other > 0.0:
        raise ValueError(f"{name}: a spread of {other:g}: more than 0")
    for value in (one, other) if two_ends else (one,):
        quantity.check(value)
    return Distribution(shape, one, other, quantity.low, quantity.high)


DRIVES_MAX = 1_000_000  # more drives are a mistake in a list
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
        lists = (len(choice) for choice in self.vary.values() if isinstance(choice, tuple))
        return len(self.seeds) * prod(lists)

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
        return make_digest([choices, *rest])


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
    crossed = itertools.product(itertools.product(*lists.values()), plan.seeds)
    for number, (listed, seed) in enumerate(crossed):
        with refusing():
            values = dict(zip(lists, listed, strict=True))
            values |= {name: each.draw(name, seed) for name, each in drawn.items()}
        yield DriveCase(number, seed, {name: values[name] for name in plan.vary})


def load_sweep(path: Path) -> SweepPlan:
    """The sweep of a file.

    Raises:
        SteerdError: it or its car file cannot be read, or says something impossible.
    """
    with refusing(f"{path}: ", code=ExitCode.INVALID):
        given = load_toml(path)
    car = given.pop("car", None)
    return make_sweep_plan(read_car(None if car is None else path.parent / str(car)), given)


def make_sweep_plan(car: CarFile, given: Mapping[str, Any]) -> SweepPlan:
    """Check what a sweep file or a caller says: seeds, duration, rate, path, speed and vary.

    Raises:
        SteerdError: something is unknown, missing or impossible.
    """
    known = (*_PARSERS, "car", "vary")
    odd = next((key for key in given if key not in known), None)
    if odd is not None:
        hint = did_you_mean(odd, known) or f"there are {', '.join(known)}"
        raise SteerdError(f"a sweep has no {odd!r}", hint)
    with refusing(code=ExitCode.INVALID):
        vary = {
            name: _parse_choice(find_quantity(name, car), choice)
            for name, choice in dict(given.get("vary", {})).items()
        }
        said = {key: parse(given[key]) for key, parse in _PARSERS.items() if key in given}
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
    listed = isinstance(given, list | tuple | range)
    whole = listed and all(type(seed) is int and seed >= 0 for seed in given)
    if not (whole and given and len(set(given)) == len(given)):
        raise ValueError("seeds: how many, or a list of different whole numbers from 0")
    return tuple(given)


def _parse_choice(quantity: Quantity, given: Any) -> Choice:
    if isinstance(given, Mapping):
        if quantity.is_text:
            raise ValueError(f"{quantity.name} is a text: give a list")
        return parse_distribution(quantity, given)
    values = given if isinstance(given, list | tuple) else [given]
    if not values:
        raise ValueError(f"{quantity.name}: the list is empty")
    if quantity.is_text:
        return tuple(_parse_path(value) for value in values)
    return tuple(map(quantity.check, values))


_PARSERS: Mapping[str, Callable[[Any], Any]] = {
    "seeds": _parse_seeds,
    "duration": Quantity("duration", 0.1, 3600.0, "s", "of a drive").check,
    "rate": Quantity("rate", 20.0, 1000.0, "Hz", "of the loop").check,
    "path": _parse_path,
    "speed": _SPEED.check,
}
"""What a sweep file may say of all drives, beside the car and what is varied."""
