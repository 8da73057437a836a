"""What a report of the learner says, for those who only read it; no numerics are loaded here."""

import json
from collections.abc import Sequence
from math import nan
from typing import Any, NamedTuple

from steerd.steer_bus import messages as m
from steerd.sysid.report.report import finite

NS = 1_000_000_000


class ReportedValue(NamedTuple):
    """One number, its standard deviation and unit, and whether the drive identifies it."""

    name: str
    value: float
    sd: float
    unit: str
    identifiable: bool = True


class ReportedChange(NamedTuple):
    """A change of the car; times are monotonic [ns]."""

    since_ns: int  # when it began; `noticed_ns` when it was called
    noticed_ns: int
    verdict: str  # `changed`, `named` or `unexplained`
    effect: str  # its name, empty unless it is named
    confidence: float  # NaN unless it is named
    alternatives: tuple[str, ...]  # effects that the drive cannot distinguish from it
    # Of the effect, by how much they moved (see `sim_gap.online.values`)
    parameters: tuple[ReportedValue, ...]


def pack(values: Sequence[tuple[Any, ...]], changes: Sequence[ReportedChange]) -> str:
    """JSON of values, in the order of `ReportedValue`, and changes; what is no number is null."""
    data = {"values": values, "changes": changes}
    return json.dumps(finite(data), separators=(",", ":"), allow_nan=False)


def reported_values(model: m.Model) -> list[ReportedValue]:
    """The car's numbers in a report."""
    return [_value(*row) for row in json.loads(model.details)["values"]]


def reported_changes(model: m.Model) -> list[ReportedChange]:
    """The changes in a report, oldest first."""
    return [
        ReportedChange(
            since, noticed, verdict, effect, _or_nan(sure), tuple(others),
            tuple(_value(*each) for each in moved),
        )
        for since, noticed, verdict, effect, sure, others, moved
        in json.loads(model.details)["changes"]
    ]  # fmt: skip


def _value(name: str, value: float | None, sd: float | None, *more: Any) -> ReportedValue:
    return ReportedValue(name, _or_nan(value), _or_nan(sd), *more)


def _or_nan(value: float | None) -> float:
    return nan if value is None else value
