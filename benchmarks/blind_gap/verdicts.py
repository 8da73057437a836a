"""Verdicts of the diagnosis (schema `steerd.gap/1`), as far as the score needs them."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.blind_gap.seal import sha256
from steerd.car_model.car_file import load_car

SCHEMA = "steerd.gap/1"
NO_GAP_SEEN = ("none", "unjudged")
VERDICTS = (*NO_GAP_SEEN, "explained", "partial", "unexplained")


class VerdictError(ValueError):
    """A verdict file that is not of the schema."""


@dataclass(frozen=True, slots=True)
class Cause:
    """One named cause; shares of the gap are fractions, NaN where the tool gave none."""

    effect: str
    confidence: float
    parameters: dict[str, float]
    predicted: float = float("nan")
    measured: float = float("nan")
    ambiguous_with: tuple[str, ...] = ()
    sds: dict[str, float] = field(default_factory=dict)
    """Standard errors of the parameters."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the tool said of a case, and how long it took [s]."""

    verdict: str
    causes: tuple[Cause, ...] = ()
    seconds: float = float("nan")
    own: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Effects that the base car had before, parameters in order: a cause's values hold them too."""

    @property
    def detected(self) -> bool:
        """Whether it saw a gap."""
        return self.verdict not in NO_GAP_SEEN

    @property
    def first(self) -> Cause | None:
        """The verdict's own cause, if it names one."""
        return self.causes[0] if self.detected and self.causes else None

    @property
    def suspects(self) -> frozenset[str]:
        """The first cause and all that is not distinguishable from it."""
        first = self.first
        return frozenset() if first is None else frozenset((first.effect, *first.ambiguous_with))


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _read_cause(entry: dict[str, Any]) -> Cause:
    shrink = entry.get("shrink") or {}
    parameters = entry.get("parameters") or {}
    return Cause(
        str(entry["effect"]),
        _number(entry.get("confidence")),
        {name: _number(p["value"]) for name, p in parameters.items()},
        _number(shrink.get("predicted")),
        _number(shrink.get("measured")),
        tuple(_name(other) for other in entry.get("ambiguous_with") or ()),
        {name: _number(p.get("sd")) for name, p in parameters.items()},
    )


def _name(other: Any) -> str:
    """An alternative's name, given as a text or as an object with an `effect`."""
    return str(other["effect"]) if isinstance(other, dict) else str(other)


def read_verdict(text: str, seconds: float = float("nan")) -> Verdict:
    """Read one verdict.

    Raises:
        VerdictError: it is not of the schema; the message says why.
    """
    try:
        data = json.loads(text)
        if data.get("schema") != SCHEMA or data.get("verdict") not in VERDICTS:
            raise VerdictError(f"schema {data.get('schema')!r}, verdict {data.get('verdict')!r}")
        return Verdict(data["verdict"], tuple(map(_read_cause, data.get("causes") or ())), seconds)
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise VerdictError(f"not a verdict: {error!r}") from error


def verdict_path(folder: Path, case: str) -> Path:
    """Where a case's verdict lies."""
    return folder / f"{case}.json"


def load_verdicts(folder: Path, cases: Iterable[str]) -> dict[str, Verdict]:
    """Verdicts by case; run times come from `CASE.time` beside them. Missing ones are left out.

    Raises:
        VerdictError: a file is not of the schema; the message names it.
    """
    found = {}
    for case in cases:
        path = verdict_path(folder, case)
        if not path.exists():
            continue
        clock = path.with_suffix(".time")
        seconds = float(clock.read_text()) if clock.exists() else float("nan")
        try:
            found[case] = read_verdict(path.read_text(), seconds)
        except VerdictError as error:
            raise VerdictError(f"{path.name}: {error}") from error
    return found


def with_own(
    verdicts: Mapping[str, Verdict], folder: Path, bases: Mapping[str, str]
) -> dict[str, Verdict]:
    """Verdicts with the effects that their base cars had, from `BASE.toml` beside them.

    Args:
        verdicts: by case.
        folder: where bases were kept.
        bases: name of each case's base.
    """
    own: dict[str, Mapping[str, Sequence[float]]] = {}
    for base in set(bases.values()):
        kept = folder / f"{base}.toml"
        car = load_car(kept) if kept.exists() else None
        names = (effect.name for effect in car.effects) if car else ()
        own[base] = dict(zip(names, car.values if car else (), strict=True))
    return {case: replace(v, own=own[bases[case]]) for case, v in verdicts.items()}


def digest_verdicts(folder: Path, cases: Iterable[str]) -> tuple[str, list[str]]:
    """One SHA-256 over all verdict files, and the cases without one."""
    lines, missing = [], []
    for case in sorted(cases):
        path = verdict_path(folder, case)
        if path.exists():
            lines.append(f"{case} {sha256(path.read_bytes())}")
        else:
            missing.append(case)
    return sha256("\n".join(lines).encode()), missing
