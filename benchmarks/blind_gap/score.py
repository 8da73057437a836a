"""Scores: what the verdicts got right, case by case and in numbers.

Every rate is given with its counts; a missing verdict counts as no detection on cases with a gap
and as a false alarm on those without.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_gap.detectability import load_severities, sigmas
from benchmarks.blind_gap.effects import EFFECTS, FAMILY, SIZES
from benchmarks.blind_gap.verdicts import Cause, Verdict

CONFIDENT = 0.8
"""A name given with at least this confidence counts as confident."""
BINS = 10
DRAWS = 2000
"""Bootstrap draws of what calibration is uncertain by."""
PAIR_SIGMAS = 7.5
"""An effect of a pair that is weaker than this alone is weaker than a small single one."""
NOT_NAMED, NO_GAP = "not named", "no gap"
OUTSIDE = "outside"
_Z = 1.96

Array = NDArray[np.float64]
Label = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Rate:
    """A share as counts; NaN without cases."""

    hits: int
    total: int

    @property
    def value(self) -> float:
        """The share."""
        return self.hits / self.total if self.total else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval."""
        if not self.total:
            return float("nan"), float("nan")
        n, p, z2 = self.total, self.value, _Z * _Z
        middle = (p + z2 / (2 * n)) / (1 + z2 / n)
        margin = _Z * sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
        return max(middle - margin, 0.0), min(middle + margin, 1.0)


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 90th percentile of a number over cases; NaN without any."""

    median: float
    p90: float
    count: int


@dataclass(frozen=True, slots=True)
class Scored:
    """One case: its label and the verdict, None if there was none."""

    label: Label
    verdict: Verdict | None

    @property
    def truths(self) -> tuple[str, ...]:
        """Names of the hidden effects."""
        return tuple(truth["effect"] for truth in self.label["truths"])

    @property
    def detected(self) -> bool:
        """Whether the verdict saw a gap."""
        return self.verdict is not None and self.verdict.detected

    @property
    def first(self) -> Cause | None:
        """The cause that the verdict stands for."""
        return self.verdict.first if self.verdict else None

    @property
    def size(self) -> str:
        """Severity of what is hidden."""
        truths = self.label["truths"]
        return str(truths[0]["size"] if truths else self.label["size"])

    @property
    def named_right(self) -> bool:
        """Whether the first cause is one of the hidden effects."""
        return self.first is not None and self.first.effect in self.truths

    @property
    def family_right(self) -> bool:
        """Whether the first cause is of a hidden effect's family."""
        families = {FAMILY[name] for name in self.truths}
        return self.first is not None and FAMILY.get(self.first.effect) in families


@dataclass(frozen=True, slots=True)
class Bin:
    """Cases whose confidence fell between two bounds."""

    low: float
    high: float
    count: int
    confidence: float
    right: float


@dataclass(frozen=True, slots=True)
class Reliability:
    """How well confidences predict how often a name is right.

    Attributes:
        bins: of equal width, those that hold cases.
        count: named causes.
        ece: expected calibration error, the bins' mean distance weighed by their cases.
        ece_interval: 95 % interval of it (bootstrap over cases).
        ece_chance: what a tool whose confidences are exactly right shows on as many cases, mean
            and 95th percentile: few cases in a bin are never right to the point.
        brier: mean square of confidence minus outcome; `brier_interval` its 95 % interval.
        brier_plain: the same for one confidence for all, the share of right names.
    """

    bins: tuple[Bin, ...]
    count: int
    ece: float
    ece_interval: tuple[float, float]
    ece_chance: tuple[float, float]
    brier: float
    brier_interval: tuple[float, float]
    brier_plain: float


@dataclass(frozen=True, slots=True)
class Scores:
    """Everything that the report prints; rates are keyed by row titles."""

    detection: dict[str, Rate]
    naming: dict[str, Rate]
    coverage: dict[str, Rate]
    set_size: dict[str, float]
    alarms: dict[str, Rate]
    pairs: dict[str, Rate]
    outside: dict[str, Rate]
    controls: dict[str, Rate]
    parameters: Spread
    shrinkage: Spread
    by_effect: dict[str, tuple[Rate, Rate, Spread]]
    reliability: Reliability
    confusion: dict[tuple[str, str], int]
    seconds: tuple[float, float, float]
    missing: int = 0
    cases: int = 0
    kinds: dict[str, int] = field(default_factory=dict)


def rate(cases: Iterable[Scored], test: Callable[[Scored], bool]) -> Rate:
    """Share of cases that pass a test."""
    results = [test(case) for case in cases]
    return Rate(sum(results), len(results))


def spread(values: Iterable[float]) -> Spread:
    """Median and 90th percentile of the finite values."""
    finite = [value for value in values if isfinite(value)]
    if not finite:
        return Spread(float("nan"), float("nan"), 0)
    return Spread(float(np.median(finite)), float(np.percentile(finite, 90)), len(finite))


class Estimates(NamedTuple):
    """A rightly named effect's parameters as far as they mean the same in the plant."""

    value: Array  # what was added to the base car, by the verdict
    true: Array  # what was added in truth
    null: Array  # what changes nothing
    sd: Array  # the verdict's standard errors


def estimates(case: Scored) -> Estimates | None:
    """The parameters of the first name, if it is right and they are comparable.

    The truth is what was added to the healthy car; of an effect that the base car already had, what
    it had is taken off the estimate.
    """
    cause = case.first
    for truth in case.label["truths"]:
        if cause is None or truth["effect"] != cause.effect:
            continue
        effect = EFFECTS[cause.effect]
        if not effect.comparable or any(p not in cause.parameters for p in effect.comparable):
            return None
        value, true, null, sd = (
            np.array([each[p] for p in effect.comparable])
            for each in (cause.parameters, truth["parameters"], effect.null, cause.sds)
        )
        own = case.verdict.own.get(cause.effect) if case.verdict else None
        if own is not None:
            value = value - np.array(own[: len(null)]) + null
        return Estimates(value, true, null, sd)
    return None


def parameter_error(case: Scored) -> float:
    """Relative error of a rightly named effect's parameters: |estimate - truth| / |truth - null|.

    NaN if the effect is not named, or its parameters mean something else in the plant.
    """
    found = estimates(case)
    if found is None:
        return float("nan")
    wrong, size = found.value - found.true, found.true - found.null
    return float(np.linalg.norm(wrong) / np.linalg.norm(size))


def shrinkage_error(case: Scored) -> float:
    """|predicted - measured| share of the gap, in points; NaN if not given."""
    cause = case.first
    return float("nan") if cause is None else 100.0 * abs(cause.predicted - cause.measured)


def _bins(sure: Array, right: Array) -> tuple[Bin, ...]:
    """Bins of equal width that hold cases."""
    place = np.minimum((sure * BINS).astype(int), BINS - 1)
    return tuple(
        Bin(i / BINS, (i + 1) / BINS, int((place == i).sum()),
            float(sure[place == i].mean()), float(right[place == i].mean()))
        for i in np.unique(place).tolist()
    )  # fmt: skip


def _ece(sure: Array, right: Array) -> float:
    return sum(b.count * abs(b.confidence - b.right) for b in _bins(sure, right)) / len(sure)


def calibration(cases: Iterable[Scored]) -> Reliability:
    """Confidence against being right, over every case with a named cause."""
    named = [(c.first.confidence, c.named_right) for c in cases if c.first is not None]
    pairs = np.array([p for p in named if isfinite(p[0])], dtype=float).reshape(-1, 2)
    sure, right = pairs.T
    if not len(sure):
        nan = float("nan")
        return Reliability((), 0, nan, (nan, nan), (nan, nan), nan, (nan, nan), nan)
    rng, square = np.random.default_rng(0), (sure - right) ** 2
    drawn = rng.integers(len(sure), size=(DRAWS, len(sure)))
    again = [_ece(sure[d], right[d]) for d in drawn]
    ideal = [_ece(sure, (rng.random(len(sure)) < sure).astype(float)) for _ in drawn]
    return Reliability(
        _bins(sure, right), len(sure), _ece(sure, right), _middle(again),
        (float(np.mean(ideal)), float(np.percentile(ideal, 95.0))),
        float(square.mean()), _middle(square[drawn].mean(axis=1)),
        float(right.mean() * (1.0 - right.mean())),
    )  # fmt: skip


def _middle(draws: Iterable[float]) -> tuple[float, float]:
    """The 95 % interval of draws."""
    low, high = np.percentile(np.array(list(draws)), [2.5, 97.5])
    return float(low), float(high)


def _named_family(case: Scored) -> str:
    """Column of the confusion matrix that a verdict falls in."""
    if not case.detected:
        return NO_GAP
    named = case.first is not None and case.verdict is not None
    confessed = case.verdict is not None and case.verdict.verdict == "unexplained"
    if not named or confessed or case.first is None:
        return NOT_NAMED
    return FAMILY.get(case.first.effect, NOT_NAMED)


def confusion(cases: Iterable[Scored]) -> dict[tuple[str, str], int]:
    """Counts by (true family, named family) of singles, nulls and defects outside the library."""
    rows: Counter[tuple[str, str]] = Counter()
    for case in cases:
        kind = case.label["kind"]
        if kind == "single":
            rows[FAMILY[case.truths[0]], _named_family(case)] += 1
        elif kind in ("null", "outside"):
            rows[NO_GAP if kind == "null" else OUTSIDE, _named_family(case)] += 1
    return dict(rows)


def wrong_name(case: Scored, least: float = CONFIDENT) -> bool:
    """Whether a case that no effect explains was given a confident name."""
    cause = case.first
    explained = case.verdict is not None and case.verdict.verdict == "explained"
    return explained and cause is not None and cause.confidence >= least


def both_named(case: Scored) -> bool:
    """Whether the first two causes are the two hidden ones."""
    causes = case.verdict.causes[:2] if case.verdict and case.verdict.detected else ()
    return {cause.effect for cause in causes} == set(case.truths)


def one_named(case: Scored) -> bool:
    """Whether at least one of the first two causes is hidden in the case."""
    causes = case.verdict.causes[:2] if case.verdict and case.verdict.detected else ()
    return any(cause.effect in case.truths for cause in causes)


def _pair_rates(pairs: Sequence[Scored]) -> dict[str, Rate]:
    """Pairs; those whose weaker effect would not show even alone are counted apart."""
    table = load_severities()

    def shows(case: Scored) -> bool:
        return all(
            sigmas(table[t["effect"]], t["strength"]) >= PAIR_SIGMAS for t in case.label["truths"]
        )

    clear = [case for case in pairs if shows(case)]
    return {
        "detected": rate(pairs, lambda c: c.detected),
        "both named": rate(pairs, both_named),
        "at least one": rate(pairs, one_named),
        f"both named, where each alone is {PAIR_SIGMAS:g} sigma": rate(clear, both_named),
        "both named, of the others": rate([c for c in pairs if c not in clear], both_named),
    }


def _groups(singles: Sequence[Scored]) -> dict[str, list[Scored]]:
    """Singles by row of the report: block and severity, and medium and large of rich drives."""
    rows: dict[str, list[Scored]] = {}
    for size in SIZES:
        for drive in ("rich", "medium", "gentle", "closed", "long"):
            held = [c for c in singles if c.size == size and c.label["block"] == f"single-{drive}"]
            rows |= {f"{drive}, {size}": held} if held else {}
    strong = [c for c in singles if c.size != "small"]
    rich = [c for c in strong if c.label["block"] == "single-rich"]
    gentle = [c for c in strong if c.label["block"] == "single-gentle"]
    return rows | {"rich, medium and large": rich, "gentle, all": gentle, "all": list(singles)}


def _alarms(nulls: Sequence[Scored]) -> dict[str, Rate]:
    """False alarms, over all nulls and by kind."""

    def alarm(case: Scored) -> bool:
        return case.verdict is None or case.detected

    blocks = sorted({case.label["block"] for case in nulls})
    by_block = {b: rate([c for c in nulls if c.label["block"] == b], alarm) for b in blocks}
    named = rate(nulls, lambda case: case.first is not None)
    return {"all nulls": rate(nulls, alarm), "a cause named": named, **by_block}


def _controls(cases: Sequence[Scored]) -> dict[str, Rate]:
    """Controls that must fail: confident names, and gaps seen where severity is 0."""
    rates = {}
    for control in ("shuffled", "reversed", "zero"):
        held = [case for case in cases if case.label["control"] == control]
        test = (lambda case: case.detected) if control == "zero" else wrong_name
        what = "gap seen at severity 0" if control == "zero" else f"{control}: confident name"
        rates[what] = rate(held, test)
    return rates


def _outside_rates(cases: Sequence[Scored]) -> dict[str, Rate]:
    return {
        "detected": rate(cases, lambda c: c.detected),
        f"confident wrong name (>= {CONFIDENT})": rate(cases, wrong_name),
        "explained by any name": rate(cases, lambda c: wrong_name(c, -1.0)),
        "unexplained or partial, of detected": rate(
            [c for c in cases if c.detected],
            lambda c: c.verdict is not None and c.verdict.verdict in ("unexplained", "partial"),
        ),
    }


def _by_effect(singles: Sequence[Scored]) -> dict[str, tuple[Rate, Rate, Spread]]:
    """Per effect, medium and large: detection, name given detection, parameter error."""
    rows = {}
    for name in EFFECTS:
        held = [c for c in singles if c.truths == (name,) and c.size != "small"]
        found = [c for c in held if c.detected]
        errors = spread(parameter_error(c) for c in found)
        rows[name] = (
            rate(held, lambda c: c.detected), rate(found, lambda c: c.named_right), errors,
        )  # fmt: skip
    return rows


def _swapped(singles: Sequence[Scored]) -> Rate:
    """Names right against the label of the next case: what chance gives."""
    found = [c for c in singles if c.detected]
    rolled = [Scored(b.label, a.verdict) for a, b in zip(found, found[1:] + found[:1], strict=True)]
    return rate(rolled, lambda c: c.named_right)


def _times(cases: Iterable[Scored]) -> tuple[float, float, float]:
    seconds = [c.verdict.seconds for c in cases if c.verdict and isfinite(c.verdict.seconds)]
    if not seconds:
        return (float("nan"),) * 3
    return float(np.median(seconds)), float(np.percentile(seconds, 90)), max(seconds)


def score(labels: Sequence[Label], verdicts: Mapping[str, Verdict]) -> Scores:
    """Score a set: labels as opened, verdicts by case name."""
    cases = [Scored(label, verdicts.get(label["name"])) for label in labels]
    kinds: dict[str, list[Scored]] = {}
    for case in cases:
        kinds.setdefault(case.label["kind"], []).append(case)
    singles = kinds.get("single", [])
    groups = _groups(singles)
    found = {row: [c for c in held if c.detected] for row, held in groups.items()}
    strong = [c for c in singles if c.size != "small"]
    judged = [c for c in cases if c.label["kind"] in ("single", "pair", "null", "outside")]
    pairs, controls = kinds.get("pair", []), kinds.get("control", [])
    return Scores(
        {row: rate(held, lambda c: c.detected) for row, held in groups.items()},
        {row: rate(held, lambda c: c.named_right) for row, held in found.items()}
        | {f"{row}: family": rate(h, lambda c: c.family_right) for row, h in found.items()},
        {row: rate(held, _covered) for row, held in found.items()},
        {row: _mean_size(held) for row, held in found.items()},
        _alarms(kinds.get("null", [])),
        _pair_rates(pairs),
        _outside_rates(kinds.get("outside", [])),
        {**_controls(controls), "names right with swapped labels": _swapped(singles)},
        spread(parameter_error(c) for c in strong),
        spread(shrinkage_error(c) for c in singles + pairs),
        _by_effect(singles),
        calibration(judged),
        confusion(cases),
        _times(cases),
        sum(case.verdict is None for case in cases),
        len(cases),
        {kind: len(held) for kind, held in kinds.items()},
    )  # fmt: skip


def _covered(case: Scored) -> bool:
    return case.verdict is not None and set(case.truths) <= case.verdict.suspects


def _mean_size(cases: Sequence[Scored]) -> float:
    sizes = [len(c.verdict.suspects) for c in cases if c.verdict and c.verdict.suspects]
    return float(np.mean(sizes)) if sizes else float("nan")
