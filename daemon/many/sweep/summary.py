"""What a sweep's table says: distributions, stops, and how much each draw moves each measure."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from steerd.daemon.common.screen import clean, wrap
from steerd.daemon.many.job import FAILED, Column, Rows
from steerd.daemon.many.sweep.plan import DRIVEN, REFUSED, STOPPED, Quantity, SweepPlan
from steerd.sysid.report.report import SCALES, Table, format_table

Array = NDArray[np.float64]
QUANTILES = (0.05, 0.5, 0.95)
_Z = 1.96  # standard deviations of a 95 % interval
STOPS = "stopped"  # the measure that says whether a watchdog stopped the drive
_LEAST = 8  # drives below which nothing is said about a dependence
_MOVES = 0.005  # a smaller move of a measure, as a share of it, is not worth a word [-]


@dataclass(frozen=True)
class Spread:
    """Distribution of a measure."""

    name: str  # name and unit of the measure
    unit: str
    low: float  # 5 % of them lie below
    middle: float  # 50 %
    high: float  # 95 %
    worst: float  # the least favourable value
    worst_drive: int  # number of the drive that has it


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
    """How much of a measure's ranks one varied quantity explains, and how far it moves it."""

    quantity: str  # names of quantity and measure
    measure: str
    # Rank correlation (Spearman's rho) of numbers; of a list of texts the correlation ratio of the
    # ranks, which has no sign
    value: float
    least: float  # what chance alone exceeds in one case in twenty
    # Mean of the measure over the fifth of the drives with the lowest and with the highest values
    # of the quantity; of texts, over those with the least and the greatest
    start: float
    end: float

    @property
    def shown(self) -> bool:
        """Whether these drives show a dependence that matters."""
        return abs(self.value) > self.least and self.size > _MOVES

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


def summarise_sweep(plan: SweepPlan, rows: Rows) -> Summary:
    """The figures of a sweep's page and screen."""
    total = len(rows)
    outcomes = Counter(str(row["outcome"]) for row in rows)
    watchdogs = Counter(str(row["watchdog"]) for row in rows if row.get("watchdog"))
    spreads = []
    for name, unit in UNITS.items():
        values = column(rows, name)
        known = np.flatnonzero(np.isfinite(values))
        if known.size:
            low, middle, high = (float(q) for q in np.quantile(values[known], QUANTILES))
            small = name.endswith("margin") or name == "damping"
            at = int(known[np.argmin(values[known]) if small else np.argmax(values[known])])
            worst, drive = float(values[at]), rows[at]["drive"]
            spreads.append(Spread(name, unit, low, middle, high, worst, drive))
    return Summary(
        tuple(make_share(name, outcomes[name], total) for name in OUTCOMES),
        tuple(make_share(name, count, total) for name, count in watchdogs.most_common()),
        tuple(spreads),
        tuple(_sensitivities(plan, rows)),
    )


def make_share(name: str, count: int, total: int) -> Share:
    """A share with Wilson's interval."""
    low, high = stats.binomtest(count, total).proportion_ci(method="wilson")
    return Share(name, count, total, float(low), float(high))


def column(rows: Rows, name: str) -> Array:
    """A column's numbers (n,); NaN where one is missing."""
    if name == STOPS:
        ends = {DRIVEN: 0.0, STOPPED: 1.0}
        return np.array([ends.get(str(row["outcome"]), np.nan) for row in rows])
    values = (row.get(name) for row in rows)
    return np.array([np.nan if value is None else float(value) for value in values])


def _sensitivities(plan: SweepPlan, rows: Rows) -> list[Sensitivity]:
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
                value = float(stats.spearmanr(given[known], seen[known]).statistic)
                low, high = np.quantile(given[known], (0.2, 0.8))  # the outer fifths, with ties
                outer = (seen[known & (given <= low)], seen[known & (given >= high)])
                means, groups = (float(outer[0].mean()), float(outer[1].mean())), 2
            elif texts is not None and len(set(texts[known])) > 1:
                each = [seen[known & (texts == text)] for text in sorted(set(texts[known]))]
                value = sqrt(stats.kruskal(*each).statistic / (known.sum() - 1))
                sizes = [float(group.mean()) for group in each]
                means, groups = (min(sizes), max(sizes)), len(each)
            else:
                continue
            least = _Z * sqrt((groups - 1) / (known.sum() - 1))
            found.append(Sensitivity(quantity.name, name, value, min(least, 1.0), *means))
    return found


MEASURES = (
    Column("e1_rms", "number", "m", "lateral error as estimated, RMS after the approach"),
    Column("e1_p95", "number", "m", "lateral error as estimated, 95 % of the time below"),
    Column("e1_max", "number", "m", "lateral error as estimated, largest"),
    Column("true_e1_rms", "number", "m", "lateral error of the simulated car itself, RMS"),
    Column("true_e1_max", "number", "m", "lateral error of the simulated car itself, largest"),
    Column("e2_rms", "number", "rad", "heading error as estimated, RMS"),
    Column("lane_margin", "number", "m", "what the largest error leaves to the watchdog's bound"),
    Column("steer_margin", "number", "1", "share of the wheel angle never used"),
    Column("damping", "number", "1", "least damping of the designed loop with the drawn car"),
    Column("delay_margin", "number", "s", "dead time that the drawn car's loop still tolerates"),
)
"""Of a drive; missing where it was not driven beyond the approach."""
_HEAD = (
    Column("drive", "count", "", "number of the drive"),
    Column("seed", "count", "", "of draws and of the simulated hardware's noise"),
)
_ENDS = (
    Column("outcome", "text", "", "driven, stopped, refused (no design) or failed"),
    Column("watchdog", "text", "", "that stopped it"),
    Column("reason", "text", "", "why it was stopped, refused or failed"),
    Column("seconds", "number", "s", "driven"),
    Column("metres", "number", "m", "driven"),
)
OUTCOMES = (DRIVEN, STOPPED, REFUSED, FAILED)


def list_columns(quantities: Iterable[Quantity]) -> Sequence[Column]:
    """The table's columns for what is varied."""
    varied = [
        Column(q.name, "text" if q.is_text else "number", q.unit, q.meaning) for q in quantities
    ]
    return (*_HEAD, *varied, *_ENDS, *MEASURES)


UNITS = {c.name: c.unit for c in MEASURES}  # SI unit by measure
_SHOWN = 8  # dependences that are shown


def describe_sweep(plan: SweepPlan, rows: Rows, summary: Summary, speed: float | None) -> str:
    """The screen: how it ended, what moved what; `speed` is that of the simulation, if known."""
    varied = ", ".join(plan.vary) or "nothing but the seeds"
    seconds = sum(row.get("seconds") or 0.0 for row in rows)
    lines = [f"drives     {len(rows)} of {plan.duration:g} s, {seconds:.0f} s driven"]
    lines += wrap(varied, "varied     ", " " * 11)
    if speed is not None:
        lines.append(f"speed      {speed:.0f} x real time")
    parts = [tabulate_ends(summary), tabulate_spreads(summary)]
    strong = list_strongest(summary)[:_SHOWN]
    if strong:
        found = []
        for s in strong:
            factor, _ = SCALES.get(UNITS.get(s.measure, ""), (1.0, ""))
            moved = (f"{factor * mean:.3g}" for mean in (s.start, s.end))
            found.append((s.quantity, name_measure(s.measure), *moved, f"{s.value:+.2f}"))
        heads = ("what moves", "what", "from", "to", "rank correlation")
        parts.append(Table(heads, found, words=(1,)))
    return "\n".join([*lines, *(line for part in parts for line in ("", *format_table(part)))])


def tabulate_ends(summary: Summary) -> Table:
    """How often drives ended in which way."""
    named = [(s.name, s) for s in summary.outcomes if s.count or s.name == DRIVEN]
    named += [(f"by {clean(s.name, 12)}", s) for s in summary.watchdogs]
    rows = [
        (name, str(s.count), f"{s.value:.1%}", f"{s.low:.1%} to {s.high:.1%}") for name, s in named
    ]
    return Table(("outcome", "drives", "share", "95 % interval"), rows)


def tabulate_spreads(summary: Summary) -> Table:
    """The distribution of each measure."""
    rows = []
    for s in summary.spreads:
        factor, _ = SCALES.get(s.unit, (1.0, ""))
        figures = (f"{value * factor:.3g}" for value in (s.low, s.middle, s.high, s.worst))
        rows.append((name_measure(s.name), *figures, str(s.worst_drive)))
    return Table(("measure", "5 %", "median", "95 %", "worst", "in drive"), rows)


def list_strongest(summary: Summary) -> list[Sensitivity]:
    """Dependences that the drives show, by how far the measure moves."""
    return sorted((s for s in summary.sensitivities if s.shown), key=lambda s: -s.size)


def name_measure(name: str) -> str:
    """A measure with the unit that people read."""
    unit = UNITS.get(name, "")
    unit = SCALES.get(unit, (1.0, "" if unit == "1" else unit))[1]
    return f"{name} [{unit}]" if unit else name
