"""What the learner knows, as a message of the bus and back."""

import json
from dataclasses import fields
from math import nan
from typing import Any, NamedTuple

from steerd.sim_gap.online.learner import Change, State
from steerd.sim_gap.online.values import Value, values_of
from steerd.steer_bus import messages as m

NS = 1_000_000_000
NONE_NS = -1
_SD = "_sd"
_LEARNT = tuple(
    field.name.removesuffix(_SD) for field in fields(m.Model) if field.name.endswith(_SD)
)
"""The car's numbers that the message has fields for."""


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


def verdict_of(state: State) -> str:
    """`learning`, `none`, or the newest change's."""
    if state.known is None:
        return "learning"
    changes = changes_of(state)
    return changes[-1].finding.verdict if changes else "none"


def changes_of(state: State) -> tuple[Change, ...]:
    """All changes so far, oldest first."""
    return (*state.past, state.change) if state.change is not None else state.past


def make_model(state: State, mono_ns: int, epoch_ns: int, dropped: int) -> m.Model:
    """The report of a state.

    Args:
        state: of the learner.
        mono_ns: of the newest pose [ns, monotonic].
        epoch_ns: UNIX time minus monotonic time [ns].
        dropped: records that were lost so far.
    """
    values = values_of(state.known) if state.known else ()
    by_name = {value.name: value for value in values}
    changes = [_told_change(change) for change in changes_of(state)]
    newest = changes[-1] if changes else None
    numbers = {
        key: number
        for name in _LEARNT
        for key, number in zip((name, name + _SD), _number(by_name.get(name)), strict=True)
    }
    return m.Model(
        header=m.make_header(mono_ns + epoch_ns, m.BODY),
        mono_ns=mono_ns,
        since_ns=newest.since_ns if newest else NONE_NS,
        noticed_ns=newest.noticed_ns if newest else NONE_NS,
        windows=state.seen,
        dropped=dropped,
        confidence=newest.confidence if newest else nan,
        **numbers,
        verdict=verdict_of(state),
        effect=newest.effect if newest else "",
        rivals=",".join(newest.rivals) if newest else "",
        identifiable=",".join(value.name for value in values if value.identifiable),
        told=_pack([ToldValue(*value) for value in values], changes),
    )


def _number(value: Value | None) -> tuple[float, float]:
    return (nan, nan) if value is None else (value.value, value.sd)


def _told_change(change: Change) -> ToldChange:
    finding, cause = change.finding, change.finding.cause
    since, noticed = round(change.since * NS), round(change.noticed * NS)
    if finding.verdict != "named":
        return ToldChange(since, noticed, finding.verdict, "", nan, (), ())
    told = tuple(
        ToldValue(name, value, sd, unit) for name, (value, sd, unit) in cause.parameters.items()
    )
    return ToldChange(
        since, noticed, finding.verdict, cause.effect, cause.confidence, cause.rivals, told
    )


def _pack(values: list[ToldValue], changes: list[ToldChange]) -> str:
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
