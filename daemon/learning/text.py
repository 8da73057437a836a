"""What was learnt, as lines of a screen and as JSON values."""

from collections.abc import Mapping
from datetime import UTC, datetime
from math import isfinite
from typing import Any

from steerd.car_model.effects import find_effect
from steerd.daemon.common.screen import join_words, wrap
from steerd.daemon.learning.reported import (
    NS,
    ReportedChange,
    ReportedValue,
    reported_changes,
    reported_values,
)
from steerd.steer_bus import messages as m
from steerd.sysid.report.report import with_error

LABEL = 13
"""Columns of a label."""
QUIET = ("learning", "none")
"""Verdicts of a car that did not change."""
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
    """JSON values: `gap` and `model`; times are UNIX."""
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
    return {"value": p.value, "sd": p.sd, "unit": p.unit}
