"""The table of what the verdicts got right, by plant."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import Any

import numpy as np

from benchmarks.blind_gap.score import (
    CONFIDENT,
    Rate,
    Reliability,
    Scored,
    both_named,
    calibration,
    estimates,
    one_named,
    parameter_error,
    rate,
    shrinkage_error,
    spread,
    wrong_name,
)
from benchmarks.blind_gap.verdicts import read_verdict

Json = dict[str, Any]
Lines = dict[str, str]

_CLOSE = 0.03
"""A parameter is right within this."""
_WIDTH = 1.645
"""Standard deviations on either side of a 90 % interval."""
_STIFFNESS = {"front": "c_sf", "rear": "c_sr"}
"""The tool's names of an axle's cornering force per load and friction."""


def scored(row: Json) -> Scored:
    """A row in the form of the blind test's scores."""
    truths = row.get("truths") or [
        {"effect": name, "size": size, "parameters": {}} for name, size in row["case"]["hidden"]
    ]
    label = {
        "name": row["name"],
        "kind": row["kind"],
        "truths": truths if row["kind"] != "outside" else [],
        "size": truths[0]["size"] if truths else "",
    }
    if "gap" not in row:
        return Scored(label, None)
    verdict = read_verdict(json.dumps(row["gap"]), row["diagnose_cpu"])
    return Scored(label, replace(verdict, own=_own(row["identify"]["parameters"])))


def _own(found: Mapping[str, Any]) -> dict[str, list[float]]:
    """Values of the effects that the base car had before."""
    own: dict[str, list[float]] = {}
    for name, entry in found.items():
        effect, _, parameter = name.partition(".")
        if parameter:
            own.setdefault(effect, []).append(entry["value"])
    return own


def _inside(cases: Sequence[Scored]) -> Rate:
    """Of first names that are right, parameters whose 90 % interval holds the truth."""
    found = [each for case in cases if (each := estimates(case))]
    away = [a for each in found for a in np.abs(each.value - each.true) / each.sd]
    return Rate(int(np.sum(np.array(away) <= _WIDTH)), len(away))


def _alarm(case: Scored) -> bool:
    return case.verdict is None or case.detected


def _covered(case: Scored) -> bool:
    return case.verdict is not None and set(case.truths) <= case.verdict.suspects


def _invented(case: Scored) -> bool:
    """Whether a cause after the first is named confidently and is not there."""
    later = case.verdict.causes[1:] if case.verdict and case.detected else ()
    return any(c.confidence >= CONFIDENT and c.effect not in case.truths for c in later)


def _confident_wrong(case: Scored) -> bool:
    """Whether the first cause is named confidently and is not there."""
    first = case.first
    return first is not None and first.confidence >= CONFIDENT and not case.named_right


def _share(value: Rate) -> str:
    if not value.total:
        return "-"
    low, high = (100.0 * bound for bound in value.interval)
    return f"{100 * value.value:.0f} % ({value.hits}/{value.total}; {low:.0f} to {high:.0f})"


def _number(value: float, unit: str = "") -> str:
    return f"{value:.3g}{unit}" if isfinite(value) else "-"


def _two(usual: float, most: float, unit: str) -> str:
    return f"{_number(usual)}; {_number(most)} {unit}"


def _median(values: Sequence[float]) -> float:
    finite = [value for value in values if isfinite(value)]
    return float(np.median(finite)) if finite else nan


def _naming(singles: Sequence[Scored]) -> Lines:
    """Single causes: seen, named, in the set."""
    found = [c for c in singles if c.detected]
    sizes = [float(len(c.verdict.suspects)) for c in found if c.verdict and c.verdict.suspects]
    by_size = {
        f"detection, {size}": _share(
            rate([c for c in singles if c.size == size], lambda c: c.detected)
        )
        for size in ("small", "medium", "large")
        if any(c.size == size for c in singles)
    }
    return by_size | {
        "first name right, of detected": _share(rate(found, lambda c: c.named_right)),
        "family right, of detected": _share(rate(found, lambda c: c.family_right)),
        f"first name wrong at {CONFIDENT} or more": _share(rate(singles, _confident_wrong)),
        "truth in the set, of detected": _share(rate(found, _covered)),
        "mean size of the set": _number(float(np.mean(sizes)) if sizes else nan),
        f"invented second name at {CONFIDENT} or more": _share(rate(singles, _invented)),
    }


def _error_of(right: Reliability) -> str:
    """With what a tool whose confidences are exactly right shows on as many names."""
    mean, high = (f"{100.0 * value:.1f}" for value in right.ece_chance)
    points = f"{_number(100.0 * right.ece)} points of {right.count} names"
    return f"{points} (chance {mean}; 95 %: {high})"


def _learnt(rows: Sequence[Json]) -> Lines:
    """What identification got of the cars, each car once."""
    cars = {(r["case"]["plant"], r["case"]["seed"]): r for r in rows if "identify" in r}
    close, inside, free, horizon = [], [], [], []
    for row in cars.values():
        found = row["identify"]["parameters"]
        for name, truth in row["car"].items():
            entry = _entry(found, name)
            if entry is None or not entry["identifiable"]:
                free.append(name)
                continue
            close.append(abs(entry["value"] / truth - 1.0) <= _CLOSE)
            if entry["sd"]:
                inside.append(abs(entry["value"] - truth) <= 1.96 * entry["sd"])
        horizon += [
            1e3 * h["position"]
            for h in row["identify"]["held_out"]["horizons"]
            if h["horizon"] == 1.0 and h["position"] is not None
        ]
    return {
        "identify: position after 1 s, median": _number(_median(horizon), " mm"),
        "identify: parameters within 3 %": _share(Rate(sum(close), len(close))),
        "identify: inside their 95 % intervals": _share(Rate(sum(inside), len(inside))),
        "identify: called not identifiable": f"{len(free)} of {len(free) + len(close)}",
        "identify: CPU, median": _number(
            _median([row["identify_cpu"] for row in cars.values()]), " s"
        ),
    }


def _entry(found: Mapping[str, Any], name: str) -> Any:
    """A parameter as the tool reports it; cornering force per load is friction times C_S."""
    if name not in _STIFFNESS:
        return found.get(name)
    stiff = found.get(_STIFFNESS[name])
    if stiff is None:
        return None
    mu = found["mu"]["value"]
    sd = None if stiff["sd"] is None else stiff["sd"] * mu
    return {**stiff, "value": stiff["value"] * mu, "sd": sd}


def score_rows(rows: Sequence[Json]) -> Lines:
    """The table's column of one plant.

    Args:
        rows: as `judge` writes them.
    """
    cases = [scored(row) for row in rows]
    kinds: dict[str, list[Scored]] = {}
    for case in cases:
        kinds.setdefault(case.label["kind"], []).append(case)
    singles, pairs = kinds.get("single", []), kinds.get("pair", [])
    nulls, outside = kinds.get("null", []), kinds.get("outside", [])
    errors = spread(parameter_error(c) for c in singles)
    shrunk = spread(shrinkage_error(c) for c in singles + pairs)
    seconds = [c.verdict.seconds for c in cases if c.verdict]
    right = calibration(cases)
    named: Callable[[Scored], bool] = lambda c: c.first is not None  # noqa: E731
    return {
        "cases; without a verdict": f"{len(cases)}; {sum(c.verdict is None for c in cases)}",
        "false alarms on nulls": _share(rate(nulls, _alarm)),
        "nulls with a name": _share(rate(nulls, named)),
        **_naming(singles),
        "pairs: both named": _share(rate(pairs, both_named)),
        "pairs: at least one": _share(rate(pairs, one_named)),
        "outside the library: detected": _share(rate(outside, lambda c: c.detected)),
        "outside the library: confident wrong": _share(rate(outside, wrong_name)),
        "expected calibration error": _error_of(right),
        "parameter error, median; 90 %": _two(100 * errors.median, 100 * errors.p90, "%"),
        "parameters inside their 90 % intervals": _share(_inside(singles)),
        "shrinkage error, median; 90 %": _two(shrunk.median, shrunk.p90, "points"),
        **_learnt(rows),
        "diagnose: CPU, median; most": _two(_median(seconds), max(seconds, default=nan), "s"),
    }


def format_table(rows: Sequence[Json]) -> str:
    """The table of all plants in Markdown."""
    plants = sorted({row["case"]["plant"] for row in rows})
    columns = [score_rows([r for r in rows if r["case"]["plant"] == p]) for p in plants]
    titles = list(dict.fromkeys(title for column in columns for title in column))
    head = ["| | " + " | ".join(plants) + " |", "|---" * (len(plants) + 1) + "|"]
    body = [
        f"| {title} | " + " | ".join(column.get(title, "-") for column in columns) + " |"
        for title in titles
    ]
    return "\n".join(head + body)


def format_cases(rows: Sequence[Json]) -> str:
    """One line a case: what was hidden, what was said."""
    lines = []
    for row in sorted(
        rows, key=lambda r: (r["case"]["plant"], r["kind"], str(r["case"]["hidden"]))
    ):
        hidden = ", ".join(f"{n} {s}" for n, s in row["case"]["hidden"]) or "nothing"
        gap = row.get("gap")
        said = row.get("error", "")[-80:] if gap is None else gap["verdict"]
        for cause in (gap or {}).get("causes") or []:
            said += f"; {cause['effect']} {cause['confidence'] or nan:.2f}"
        lines.append(f"{row['case']['plant']:15} {hidden:32} {said}")
    return "\n".join(lines)
