"""What a report of the learner says: its values and changes, as lines and as JSON values.

No numerics are loaded here.
"""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite, nan
from typing import Any, NamedTuple

from steerd.car_model.effects import find_effect
from steerd.daemon.common.screen import join_words, wrap
from steerd.steer_bus import messages as m
from steerd.sysid.report.report import finite, with_error

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
    parameters: tuple[ReportedValue, ...]  # of the effect, by how much they moved (`online.values`)


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


# -- in words -------------------------------------------------------------------------------------

LABEL = 13  # columns of a label
QUIET = ("learning", "none")  # verdicts of a car that did not change
_VERDICTS = {
    "learning": "learning the car",
    "none": "no change of the car",
    "changed": "something changed, too early to say what",
    "unexplained": "something changed that no effect explains",
}


def with_sd(parameter: ReportedValue, sign: str = "") -> str:
    """A number, its standard deviation to two digits and its unit, on one line."""
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    if not isfinite(parameter.sd) or parameter.sd <= 0.0:
        return join_words(f"{parameter.value:{sign}.4g}{unit}")
    return join_words(f"{with_error(parameter.value, parameter.sd, sign)}{unit}")


def describe_change(model: m.Model, change: ReportedChange) -> str:
    """One change in one sentence."""
    stamp = m.stamp_ns(model.header) - model.mono_ns + change.since_ns
    since = f"since {datetime.fromtimestamp(stamp // NS, UTC):%H:%M:%S}"
    if change.verdict != "named":
        return f"{since}: {_VERDICTS[change.verdict]}"
    several = len(change.parameters) > 1
    nulls = find_effect(change.effect).nulls
    reported = ", ".join(
        f"{part.name} " * several + with_sd(part, "+" if null == 0.0 else "")
        for part, null in zip(change.parameters, nulls, strict=True)
    )
    sure = join_words(f"{100.0 * change.confidence:.0f} %")
    others = ", ".join(change.alternatives)
    alike = f"; this drive cannot distinguish it from {others}" if others else ""
    return f"{since}: {change.effect} {reported}, {sure}{alike}"


def gap_text(model: m.Model) -> str:
    """The newest change, or why there is none."""
    changes = reported_changes(model)
    if changes:
        return describe_change(model, changes[-1])
    return _VERDICTS[model.verdict]


def design_text(status: Mapping[str, str]) -> str:
    """Which design steers, and why it is the car file's."""
    why = status.get("design_why", "")
    return f"{status['design']} ({why})" if why else status["design"]


def format_model(model: m.Model) -> list[str]:
    """Everything that was learnt, in lines of at most 80 columns."""
    lines = []
    if model.verdict in QUIET:
        lines += wrap(_VERDICTS[model.verdict], f"{'gap:':<{LABEL}}", " " * LABEL)
    for change in reported_changes(model):
        lines += wrap(describe_change(model, change), f"{'gap:':<{LABEL}}", " " * LABEL)
    values = reported_values(model)
    reported = [p for p in values if p.identifiable]
    width = max((len(p.name) for p in reported), default=0) + 2
    lines += [f"  {p.name:<{width}}{with_sd(p)}".replace("\u00a0", " ") for p in reported]
    dark = [p.name for p in values if not p.identifiable]
    if dark:
        lines += wrap(", ".join(dark), "not identifiable here: ", "  ")
    return lines


def encode_model(model: m.Model) -> dict[str, Any]:
    """JSON values: `gap` and `model`; times are UNIX, what is not known is null."""
    epoch_ns = m.stamp_ns(model.header) - model.mono_ns
    changes = [
        {
            "verdict": change.verdict,
            "since_s": (epoch_ns + change.since_ns) * 1e-9,
            "noticed_s": (epoch_ns + change.noticed_ns) * 1e-9,
            "causes": [_cause(change)] if change.effect else [],
        }
        for change in reported_changes(model)
    ]
    newest = changes[-1] if changes else {"since_s": None, "causes": []}
    return {
        "gap": {
            "verdict": model.verdict,
            "since_s": newest["since_s"],
            "causes": newest["causes"],
            "changes": changes,
        },
        "model": {
            p.name: _number(p) | {"identifiable": bool(p.identifiable)}
            for p in reported_values(model)
        },
    }


def _cause(change: ReportedChange) -> dict[str, Any]:
    return {
        "effect": change.effect,
        "parameters": {p.name: _number(p) for p in change.parameters},
        "confidence": change.confidence,
        "alternatives": list(change.alternatives),
    }


def _number(p: ReportedValue) -> dict[str, Any]:
    return {"value": finite(p.value), "sd": finite(p.sd), "unit": p.unit}
