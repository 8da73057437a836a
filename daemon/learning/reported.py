"""What a report of the learner says: its values and changes, as lines and as JSON values.

No numerics are loaded here.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite, nan
from typing import Any, NamedTuple, TypeVar

from steerd.car_model.effects import find_effect
from steerd.daemon.common.screen import NBSP, join_words, wrap
from steerd.steer_bus import messages as m
from steerd.sysid.report.report import finite, with_error

NS = 1_000_000_000
T = TypeVar("T")


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
    effect: str = ""  # its name, empty unless it is named
    confidence: float = nan  # NaN unless it is named
    alternatives: Sequence[str] = ()  # effects that the drive cannot distinguish from it
    # Of the effect, by how much they moved (`online.values`)
    parameters: Sequence[ReportedValue] = ()


def pack(values: Sequence[tuple[Any, ...]], changes: Sequence[ReportedChange]) -> str:
    """JSON of values, in the order of `ReportedValue`, and changes; what is no number is null."""
    data = {"values": values, "changes": changes}
    return json.dumps(finite(data), separators=(",", ":"), allow_nan=False)


def reported_values(model: m.Model) -> list[ReportedValue]:
    """The car's numbers in a report."""
    return [_read(ReportedValue, row) for row in json.loads(model.details)["values"]]


def reported_changes(model: m.Model) -> list[ReportedChange]:
    """The changes in a report, oldest first."""
    changes = [_read(ReportedChange, row) for row in json.loads(model.details)["changes"]]
    return [
        change._replace(parameters=[_read(ReportedValue, row) for row in change.parameters])
        for change in changes
    ]


def _read(kind: Callable[..., T], row: Sequence[Any]) -> T:
    """A row of JSON as its tuple, null as NaN."""
    return kind(*(nan if each is None else each for each in row))


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
    return describe_change(model, changes[-1]) if changes else _VERDICTS[model.verdict]


def design_text(status: Mapping[str, str]) -> str:
    """Which design steers, and why it is the car file's."""
    why = status.get("design_why", "")
    return f"{status['design']} ({why})" if why else status["design"]


def format_model(model: m.Model) -> list[str]:
    """Everything that was learnt, in lines of at most 80 columns."""
    texts = [_VERDICTS[model.verdict]] if model.verdict in QUIET else []
    texts += [describe_change(model, change) for change in reported_changes(model)]
    lines = [row for text in texts for row in wrap(text, f"{'gap:':<{LABEL}}", " " * LABEL)]
    values = reported_values(model)
    reported = [p for p in values if p.identifiable]
    width = max((len(p.name) for p in reported), default=0) + 2
    lines += [f"  {p.name:<{width}}{with_sd(p)}".replace(NBSP, " ") for p in reported]
    if dark := [p.name for p in values if not p.identifiable]:
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
    named = {name: newest[name] for name in ("since_s", "causes")}
    values = reported_values(model)
    return {
        "gap": {"verdict": model.verdict, **named, "changes": changes},
        "model": {p.name: _number(p) | {"identifiable": bool(p.identifiable)} for p in values},
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
