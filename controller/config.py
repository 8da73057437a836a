"""What a person may set about the controller, and how it is read from a configuration file."""

import difflib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import NamedTuple

DESIGNS = ("lqr", "pole_placement")
PAPER_POLES: tuple[complex, ...] = (-2 + 2j, -2 - 2j, -150 + 15j, -150 - 15j)
"""Closed-loop poles of the IROS 2023 paper's state feedback [1/s]."""
GRID_SPEEDS_MAX = 400  # most design speeds: each costs a Riccati equation at start
SPEED_CEILING = 20.0  # no car of this class is faster [m/s]; a typing error is


class LqrWeights(NamedTuple):
    """Quadratic costs of the `lqr` design, per second; only their ratios matter.

    The defaults value 0.5 m of offset, 1 rad of heading error and 1 rad of steering alike.
    """

    e1: float = 4.0  # [1/m^2]
    e1_rate: float = 0.0  # [s^2/m^2]
    e2: float = 1.0  # [1/rad^2]
    e2_rate: float = 0.0  # [s^2/rad^2]
    steer: float = 0.0  # wheel angle beyond that of the turn [1/rad^2]
    effort: float = 1.0  # steering reference beyond that of the turn [1/rad^2]


@dataclass(frozen=True, kw_only=True)
class ControllerConfig:
    """The controller's settings. SI units.

    Raises:
        ValueError: a setting cannot be; one line each.
    """

    design: str = "lqr"
    poles: tuple[complex, ...] = PAPER_POLES
    """Of `pole_placement`, continuous [1/s]: four, complex ones in conjugate pairs."""
    weights: LqrWeights = field(default_factory=LqrWeights)
    damping_min: float = 0.1  # a closed loop with a mode less damped than this is refused
    grid_speed_min: float = 0.1
    """Lowest design speed [m/s]; its gains hold below. `pole_placement` starts no lower than where
    the tyre equations hold alone (`steerd.car_model.chassis.SPEED_DYNAMIC`): a car that rolls
    without slip has one fast mode that no steering moves."""
    grid_spacing: float = 0.25  # largest distance between design speeds [m/s]
    speed: float = 1.0  # speed to drive where nothing asks for less [m/s]
    file_speeds: bool = True  # whether a raceline's own speeds cap it
    lateral_accel_max: float = 2.0  # v^2 |curvature| of the speed profile [m/s^2]
    accel_max: float = 1.5  # growth of the speed along the path [m/s^2]
    decel_max: float = 1.5  # fall of the speed before a corner or an end [m/s^2]
    start_ramp: float = 1.5  # growth of the speed reference in time [m/s^2]
    stop_ramp: float = 1.5  # fall of the speed reference on a stop request [m/s^2]

    def __post_init__(self) -> None:
        problems = [*_number_problems(self), *_pole_problems(self.poles)]
        if self.design not in DESIGNS:
            problems.append(f"design = {self.design!r}: use {' or '.join(DESIGNS)}")
        if problems:
            raise ValueError("\n".join(problems))


_POSITIVE = (
    "grid_speed_min", "grid_spacing", "speed", "lateral_accel_max", "accel_max", "decel_max",
    "start_ramp", "stop_ramp",
)  # fmt: skip


def _number_problems(config: ControllerConfig) -> list[str]:
    values = asdict(config)
    problems = [
        f"{name} = {values[name]}: must be positive and finite"
        for name in _POSITIVE
        if not 0.0 < values[name] < math.inf
    ]
    if not 0.0 <= config.damping_min < 1.0:
        problems.append(f"damping_min = {config.damping_min}: must be in [0, 1)")
    if config.speed > SPEED_CEILING:
        problems.append(f"speed = {config.speed}: above {SPEED_CEILING} m/s")
    if config.grid_spacing > 0.0 and config.speed / config.grid_spacing > GRID_SPEEDS_MAX:
        problems.append(f"grid_spacing = {config.grid_spacing}: over {GRID_SPEEDS_MAX} speeds")
    for name, weight in config.weights._asdict().items():
        if not 0.0 <= weight < math.inf:
            problems.append(f"weights.{name} = {weight}: must be finite and not negative")
    if not (config.weights.effort > 0.0 and config.weights.e1 > 0.0):
        problems.append("weights.effort and weights.e1 must be positive")
    return problems


def _pole_problems(poles: tuple[complex, ...]) -> list[str]:
    problems = []
    if len(poles) != 4:
        problems.append(f"poles: {len(poles)} given; the lane errors have four states")
    if not all(math.isfinite(abs(p)) and p.real < 0.0 for p in poles):
        problems.append("poles: each needs a negative real part, or the design itself is unstable")
    if any(poles.count(p) != poles.count(p.conjugate()) for p in poles):
        problems.append("poles: complex ones come in conjugate pairs, as -2+2j with -2-2j")
    return problems


def load_controller_config(mapping: Mapping[str, object]) -> ControllerConfig:
    """The configuration in a mapping, such as a TOML table `[controller]`.

    Poles are texts (`"-2+2j"`), numbers or `[re, im]`; `weights` is a table. What is absent keeps
    its default.

    Raises:
        ValueError: an unknown name (with the nearest known one), a wrong type or a wrong value.
    """
    known = [f.name for f in fields(ControllerConfig)]
    _refuse_unknown(mapping, known, "controller")
    values: dict[str, object] = {}
    for name, value in mapping.items():
        if name == "poles":
            values[name] = _poles(value)
        elif name == "weights":
            values[name] = _weights(value)
        elif name in ("design", "file_speeds"):
            expected = str if name == "design" else bool
            if not isinstance(value, expected):
                raise ValueError(f"controller.{name} = {value!r}: must be a {expected.__name__}")
            values[name] = value
        else:
            values[name] = _number(value, f"controller.{name}")
    return ControllerConfig(**values)  # type: ignore[arg-type]


def _refuse_unknown(mapping: Mapping[str, object], known: list[str], where: str) -> None:
    for name in mapping:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise ValueError(f"{where}.{name} is not a setting; {hint}")


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{where} = {value!r}: must be a number")
    return float(value)


def _weights(value: object) -> LqrWeights:
    if not isinstance(value, Mapping):
        raise ValueError(f"controller.weights = {value!r}: must be a table, as {{ e1 = 4.0 }}")
    _refuse_unknown(value, list(LqrWeights._fields), "controller.weights")
    return LqrWeights(**{k: _number(v, f"controller.weights.{k}") for k, v in value.items()})


def _poles(value: object) -> tuple[complex, ...]:
    if not isinstance(value, list | tuple):
        raise ValueError(f'controller.poles = {value!r}: must be a list, as ["-2+2j", "-2-2j"]')
    return tuple(_pole(item) for item in value)


def _pole(item: object) -> complex:
    if isinstance(item, str):
        try:
            return complex(item.replace(" ", "").replace("i", "j"))
        except ValueError:
            raise ValueError(f'controller.poles: {item!r} is no pole; write "-2+2j"') from None
    if isinstance(item, list | tuple) and len(item) == 2:
        re, im = (_number(part, "controller.poles") for part in item)
        return complex(re, im)
    if isinstance(item, complex):
        return item
    return complex(_number(item, "controller.poles"))
