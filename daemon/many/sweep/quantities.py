"""What a sweep may vary: the drive, the simulated car, its effects, its instruments.

`path`, `speed`, `car.NAME` (a parameter of the simulated car), `effect.NAME` or
`effect.NAME.PARAMETER`, and the noise and delay of mocap and VESC.
"""

from typing import NamedTuple

from steerd.car_model.car_file import CarFile
from steerd.car_model.effects import find_effect
from steerd.car_model.params import PARAMETERS
from steerd.daemon.common.errors import did_you_mean
from steerd.sim_hw.mocap.mocap_config import MocapConfig
from steerd.sim_hw.vesc.vesc_config import VescConfig


class Quantity(NamedTuple):
    """One thing that may be varied.

    Attributes:
        name: as a sweep file says it.
        low, high: bounds.
        unit: SI, `1` for none; empty for a text.
        meaning: one line.
        usual: the car file's or the simulator's own value; None where there is none.
    """

    name: str
    low: float
    high: float
    unit: str
    meaning: str
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
