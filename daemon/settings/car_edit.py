"""Set values in a car file, and convert them from and to F1TENTH's `vesc.yaml`.

Of a car file comments, order and everything else stay. Of a `vesc.yaml` only lines `name: number`
are read, so comments and other nodes' parameters stay, and no YAML library is needed. Names and
meaning: f1tenth_system, `vesc.yaml` (humble-devel).
"""

# Why: docs/decisions/rooms-and-code.md#d28

import re
from collections.abc import Mapping
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path
from typing import Any

import tomlkit

from steerd.car_model.car_file import CarFile, CarFileError, parse_car
from steerd.daemon.common.errors import ExitCode, SteerdError, make_car_file_error, refusing
from steerd.daemon.settings.config import make_settings
from steerd.vesc_link.scaling import Scaling

Values = Mapping[tuple[str, str], float | str]  # new values by (section, key)


def edit_car(base: CarFile, values: Values) -> CarFile:
    """The car file with new values, added where it lacks them; a SteerdError if that is no car."""
    document = tomlkit.parse(base.text)
    edit_document(document, values)
    try:
        car = parse_car(tomlkit.dumps(document), Path("the new car file"), base.posterior)
        make_settings(car)
    except CarFileError as error:
        raise make_car_file_error(error) from None
    return car


def edit_document(document: Any, values: Values) -> None:
    """Set values in the TOML document of a car file, comments kept."""
    for (section, key), value in values.items():
        document.setdefault(section, tomlkit.table())[key] = value


# -- vesc.yaml -------------------------------------------------------------------------------------

NAMES = {
    "speed_to_erpm_gain": "erpm_gain",
    "speed_to_erpm_offset": "erpm_offset",
    "steering_angle_to_servo_gain": "servo_gain",
    "steering_angle_to_servo_offset": "servo_offset",
    "servo_min": "servo_min",
    "servo_max": "servo_max",
    "speed_max": "erpm_max",
}
_LINE = re.compile(
    rf"^(\s*(?P<name>{'|'.join(NAMES)})\s*:\s*)(?P<value>[^\s#]+)(?P<rest>\s*(?:#.*)?)$",
    re.MULTILINE,
)
_SPEED_MIN = re.compile(r"^(\s*speed_min\s*:\s*)[^\s#]+", re.MULTILINE)


def read_vesc_yaml(text: str, base: Scaling) -> Scaling:
    """The calibration of a `vesc.yaml`; what it does not name comes from `base`.

    A SteerdError where it names no gain, one twice with different values, or an invalid value.
    """
    found: dict[str, float] = {}
    for match in _LINE.finditer(text):
        name = match["name"]
        try:
            value = float(match["value"])
        except ValueError:
            value = nan
        if not isfinite(value):
            raise SteerdError(f"vesc.yaml: {name}: {match['value']!r} is not a number")
        if found.setdefault(name, value) != value:
            raise SteerdError(f"vesc.yaml gives {name} twice: {found[name]:g} and {value:g}")
    if not found:
        hint = f"it should hold some of {', '.join(NAMES)}"
        raise SteerdError("no gain of F1TENTH's vesc.yaml in this file", hint)
    values = {NAMES[name]: abs(v) if name == "speed_max" else v for name, v in found.items()}
    with refusing("vesc.yaml: ", code=ExitCode.INVALID):
        return replace(base, **values)


def make_vesc_yaml(scaling: Scaling, text: str = "") -> str:
    """A `vesc.yaml` with this calibration: `text` with new numbers, or a fresh one."""
    values = {name: getattr(scaling, field) for name, field in NAMES.items()}

    def number(match: re.Match[str]) -> str:
        return f"{match[1]}{float(values[match['name']])!r}{match['rest']}"

    fresh = Path(__file__).with_name("vesc.yaml")
    new = _LINE.sub(number, text or fresh.read_text(encoding="utf-8"))
    return _SPEED_MIN.sub(lambda m: f"{m[1]}{-float(scaling.erpm_max)!r}", new)


def make_car_values(scaling: Scaling) -> Mapping[tuple[str, str], float]:
    """The calibration as values of a car file."""
    return {("vesc", field): float(getattr(scaling, field)) for field in NAMES.values()}
