"""What a report of the learner tells, for those who only read it; no numerics are loaded here."""

import json
from math import nan
from typing import Any, NamedTuple

from steerd.steer_bus import messages as m

NS = 1_000_000_000


class ToldValue(NamedTuple):
    """One number, with its standard deviation and unit; `identifiable` where the drive tells it."""

    name: str
    value: float
    sd: float
    unit: str
    identifiable: bool = True


class ToldChange(NamedTuple):
    """A change of the car; times are monotonic [ns].

    Attributes:
        since_ns: when it began; `noticed_ns` when it was called.
        verdict: `changed`, `named` or `unexplained`.
        effect: its name, empty unless it is named.
        confidence: NaN unless it is named.
        rivals: effects that the drive cannot tell from it.
        parameters: of the effect, as they are since then.
    """

    since_ns: int
    noticed_ns: int
    verdict: str
    effect: str
    confidence: float
    rivals: tuple[str, ...]
    parameters: tuple[ToldValue, ...]


def pack(values: list[ToldValue], changes: list[ToldChange]) -> str:
    """JSON of values and changes; what is no number is null."""
    data = {"values": values, "changes": changes}
    return json.dumps(_finite(data), separators=(",", ":"), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if value - value == 0.0 else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list | tuple) else value


def values_told(model: m.Model) -> list[ToldValue]:
    """The car's numbers in a report."""
    return [_value(each) for each in json.loads(model.told)["values"]]


def changes_told(model: m.Model) -> list[ToldChange]:
    """The changes in a report, oldest first."""
    return [
        ToldChange(
            since, noticed, verdict, effect, _or_nan(sure), tuple(rivals), tuple(map(_value, told))
        )
        for since, noticed, verdict, effect, sure, rivals, told in json.loads(model.told)["changes"]
    ]


def _value(row: list[Any]) -> ToldValue:
    name, value, sd, unit, identifiable = row
    return ToldValue(name, _or_nan(value), _or_nan(sd), unit, identifiable)


def _or_nan(value: float | None) -> float:
    return nan if value is None else value
