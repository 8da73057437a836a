"""What a sweep's table says: distributions, stops, and how much each draw moves each measure."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.many.sweep.measures import DRIVEN, MEASURES, OUTCOMES, STOPPED
from steerd.daemon.many.sweep.plan import SweepPlan

Array = NDArray[np.float64]
QUANTILES = (0.05, 0.5, 0.95)
_Z = 1.96
"""Standard deviations of a 95 % interval."""
STOPS = "stopped"
"""The measure that says whether a watchdog stopped the drive."""
_LEAST = 8
"""Drives below which nothing is said about a dependence."""


@dataclass(frozen=True)
class Spread:
    """Distribution of a measure.

    Attributes:
        name, unit: of the measure.
        count: drives that have it.
        low, middle, high: 5 %, 50 % and 95 % of them lie below.
        worst: the least favourable value.
        worst_drive: number of the drive that has it.
    """

    name: str
    unit: str
    count: int
    low: float
    middle: float
    high: float
    worst: float
    worst_drive: int


@dataclass(frozen=True)
class Share:
    """How often something happened, with a 95 % interval (Wilson's)."""

    name: str
    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself."""
        return self.count / self.of


@dataclass(frozen=True)
class Sensitivity:
    """How much of a measure's ranks one varied quantity explains, and how far it moves it.

    Attributes:
        quantity, measure: their names.
        value: rank correlation (Spearman's rho) of numbers; of a list of texts the correlation
            ratio of the ranks, which has no sign.
        least: what chance alone exceeds in one case in twenty.
        start, end: mean of the measure over the fifth of the drives with the lowest and with the
            highest values of the quantity; of texts, over those with the least and the greatest.
    """

    quantity: str
    measure: str
    value: float
    least: float
    start: float
    end: float

    @property
    def shown(self) -> bool:
        """Whether these drives show a dependence."""
        return abs(self.value) > self.least

    @property
    def size(self) -> float:
        """The move as a share of the larger of the two means."""
        largest = max(abs(self.start), abs(self.end))
        return abs(self.end - self.start) / largest if largest > 0.0 else 0.0


@dataclass(frozen=True)
class Summary:
    """What a sweep's table says."""

    outcomes: tuple[Share, ...]
    watchdogs: tuple[Share, ...]
    spreads: tuple[Spread, ...]
    sensitivities: tuple[Sensitivity, ...]


def summarise_sweep(plan: SweepPlan, rows: Sequence[Mapping[str, Any]]) -> Summary:
    """The figures of a sweep's page and screen."""
    total = len(rows)
    outcomes = Counter(str(row["outcome"]) for row in rows)
    watchdogs = Counter(str(row["watchdog"]) for row in rows if row.get("watchdog"))
    spreads = [_spread(column.name, column.unit, rows) for column in MEASURES]
    return Summary(
        tuple(make_share(name, outcomes[name], total) for name in OUTCOMES),
        tuple(make_share(name, count, total) for name, count in watchdogs.most_common()),
        tuple(spread for spread in spreads if spread is not None),
        tuple(_sensitivities(plan, rows)),
    )


def make_share(name: str, count: int, total: int) -> Share:
    """A share with Wilson's interval."""
    p, z2 = count / total, _Z * _Z / total
    middle, half = (
        (p + z2 / 2) / (1 + z2),
        _Z / (1 + z2) * sqrt(p * (1 - p) / total + z2 / 4 / total),
    )
    return Share(name, count, total, max(middle - half, 0.0), min(middle + half, 1.0))


def column(rows: Sequence[Mapping[str, Any]], name: str) -> Array:
    """A column's numbers (n,); NaN where one is missing."""
    if name == STOPS:
        ends = {DRIVEN: 0.0, STOPPED: 1.0}
        return np.array([ends.get(str(row["outcome"]), np.nan) for row in rows])
    values = (row.get(name) for row in rows)
    return np.array([np.nan if value is None else float(value) for value in values])


def _spread(name: str, unit: str, rows: Sequence[Mapping[str, Any]]) -> Spread | None:
    values = column(rows, name)
    known = np.flatnonzero(np.isfinite(values))
    if not known.size:
        return None
    low, middle, high = (float(q) for q in np.quantile(values[known], QUANTILES))
    small = name.endswith("margin") or name == "damping"
    at = int(known[np.argmin(values[known]) if small else np.argmax(values[known])])
    return Spread(name, unit, known.size, low, middle, high, float(values[at]), rows[at]["drive"])


def _sensitivities(plan: SweepPlan, rows: Sequence[Mapping[str, Any]]) -> list[Sensitivity]:
    """Each varied quantity against each measure; none where either does not vary."""
    found = []
    for quantity in plan.quantities:
        texts = np.array([str(row[quantity.name]) for row in rows]) if quantity.is_text else None
        given = None if quantity.is_text else column(rows, quantity.name)
        for name in (*(c.name for c in MEASURES), STOPS):
            seen = column(rows, name)
            known = np.isfinite(seen)
            if known.sum() < _LEAST or np.ptp(seen[known]) == 0.0:
                continue
            if given is not None and np.ptp(given[known]) > 0.0:
                value, groups = _rank_correlation(given[known], seen[known]), 2
                means = _outer_means(given[known], seen[known])
            elif texts is not None and len(set(texts[known])) > 1:
                value, groups = _correlation_ratio(texts[known], seen[known])
                each = [float(seen[known & (texts == text)].mean()) for text in set(texts[known])]
                means = min(each), max(each)
            else:
                continue
            least = _Z * sqrt((groups - 1) / (known.sum() - 1))
            found.append(Sensitivity(quantity.name, name, value, min(least, 1.0), *means))
    return found


def rank(values: Array) -> Array:
    """Ranks (n,) of values, ties shared."""
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return np.asarray((last - 0.5 * (counts - 1))[index], dtype=np.float64)


def _outer_means(given: Array, seen: Array) -> tuple[float, float]:
    """Means of a measure over the lowest and the highest fifth of a quantity, ties included."""
    low, high = np.quantile(given, (0.2, 0.8))
    return float(seen[given <= low].mean()), float(seen[given >= high].mean())


def _rank_correlation(one: Array, other: Array) -> float:
    return float(np.corrcoef(rank(one), rank(other))[0, 1])


def _correlation_ratio(texts: NDArray[Any], seen: Array) -> tuple[float, int]:
    """Share of the ranks' standard deviation that lies between groups, and how many there are."""
    ranks = rank(seen)
    names = sorted(set(texts))
    means = [(np.sum(texts == name), ranks[texts == name].mean()) for name in names]
    between = sum(count * (mean - ranks.mean()) ** 2 for count, mean in means)
    return sqrt(float(between / np.sum((ranks - ranks.mean()) ** 2))), len(names)
