"""What a sweep's table says: distributions, stops, and how much each draw moves each measure."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from scipy import stats

from steerd.daemon.common.screen import clean, wrap
from steerd.daemon.many.job import FAILED, Column, Found, Rows
from steerd.daemon.many.sweep.plan import DRIVEN, REFUSED, STOPPED, SweepPlan
from steerd.sysid.data.data_checks import Array
from steerd.sysid.report.report import SCALES, Table, format_table

QUANTILES = (0.05, 0.5, 0.95)
_Z = 1.96  # standard deviations of a 95 % interval
STOPS = "stopped"  # the measure that says whether a watchdog stopped the drive
_LEAST = 8  # drives below which nothing is said about a dependence
_MOVES = 0.005  # a smaller move of a measure, as a share of it, is not worth a word [-]
_SHOWN = 8  # dependences that are shown
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
UNITS = {c.name: c.unit for c in MEASURES}  # SI unit by measure
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


def make_share(name: str, count: int, total: int) -> Share:
    """A share with Wilson's interval."""
    low, high = stats.binomtest(count, total).proportion_ci(method="wilson")
    return Share(name, count, total, float(low), float(high))


def column(rows: Rows, name: str) -> Array:
    """A column's numbers (n,); NaN where one is missing."""
    if name == STOPS:
        ends = {DRIVEN: 0.0, STOPPED: 1.0}
        return np.array([ends.get(str(row["outcome"]), np.nan) for row in rows])
    return np.array([row.get(name) for row in rows], dtype=float)


def _sensitivities(plan: SweepPlan, rows: Rows) -> list[Sensitivity]:
    """Each varied quantity against each measure; none where either does not vary."""
    found = []
    for quantity in plan.quantities:
        given = np.array([row[quantity.name] for row in rows])
        for name in (*UNITS, STOPS):
            seen = column(rows, name)
            known = np.isfinite(seen)
            kinds = np.unique(given[known])
            if known.sum() < _LEAST or np.ptp(seen[known]) == 0.0 or len(kinds) < 2:
                continue
            if quantity.is_text:
                each = [seen[known & (given == text)] for text in kinds]
                value = sqrt(stats.kruskal(*each).statistic / (known.sum() - 1))
                sizes = [float(group.mean()) for group in each]
                means, groups = (min(sizes), max(sizes)), len(each)
            else:
                value = float(stats.spearmanr(given[known], seen[known]).statistic)
                low, high = np.quantile(given[known], (0.2, 0.8))  # the outer fifths, with ties
                outer = (seen[known & (given <= low)], seen[known & (given >= high)])
                means, groups = (float(outer[0].mean()), float(outer[1].mean())), 2
            least = _Z * sqrt((groups - 1) / (known.sum() - 1))
            found.append(Sensitivity(quantity.name, name, value, min(least, 1.0), *means))
    return found


def find_scale(name: str) -> tuple[float, str]:
    """From a measure's SI unit to the unit that people read; the measure's name with that."""
    unit = UNITS.get(name, "")
    factor, unit = SCALES.get(unit, (1.0, unit))
    return factor, f"{name} [{unit}]" if unit else name


@dataclass(frozen=True, eq=False)
class Summary(Found):
    """The drives of a sweep and their figures; `str` is the screen of `steerd sweep`."""

    plan: SweepPlan  # what was driven

    @property
    def columns(self) -> Sequence[Column]:
        """The columns of the table with units and meanings."""
        varied = (
            Column(q.name, "text" if q.is_text else "number", q.unit, q.meaning)
            for q in self.plan.quantities
        )
        return (*_HEAD, *varied, *_ENDS, *MEASURES)

    @cached_property
    def outcomes(self) -> tuple[Share, ...]:
        """How often drives ended in which way."""
        counts = Counter(str(row["outcome"]) for row in self.rows)
        names = (DRIVEN, STOPPED, REFUSED, FAILED)
        return tuple(make_share(name, counts[name], len(self.rows)) for name in names)

    @cached_property
    def watchdogs(self) -> tuple[Share, ...]:
        """How often each watchdog stopped a drive."""
        counts = Counter(str(row["watchdog"]) for row in self.rows if row.get("watchdog"))
        return tuple(make_share(name, n, len(self.rows)) for name, n in counts.most_common())

    @cached_property
    def spreads(self) -> tuple[Spread, ...]:
        """The distribution of each measure."""
        spreads = []
        for name, unit in UNITS.items():
            values = column(self.rows, name)
            known = np.flatnonzero(np.isfinite(values))
            if known.size:
                low, middle, high = (float(q) for q in np.quantile(values[known], QUANTILES))
                small = name.endswith("margin") or name == "damping"
                at = int(known[np.argmin(values[known]) if small else np.argmax(values[known])])
                worst, drive = float(values[at]), self.rows[at]["drive"]
                spreads.append(Spread(name, unit, low, middle, high, worst, drive))
        return tuple(spreads)

    @cached_property
    def sensitivities(self) -> tuple[Sensitivity, ...]:
        """How much each varied quantity moves each measure."""
        return tuple(_sensitivities(self.plan, self.rows))

    def list_strongest(self) -> list[Sensitivity]:
        """Dependences that the drives show, by how far the measure moves."""
        return sorted((s for s in self.sensitivities if s.shown), key=lambda s: -s.size)

    def tabulate_ends(self) -> Table:
        """How often drives ended in which way."""
        named = [(s.name, s) for s in self.outcomes if s.count or s.name == DRIVEN]
        named += [(f"by {clean(s.name, 12)}", s) for s in self.watchdogs]
        rows = [
            (n, str(s.count), f"{s.value:.1%}", f"{s.low:.1%} to {s.high:.1%}") for n, s in named
        ]
        return Table(("outcome", "drives", "share", "95 % interval"), rows)

    def tabulate_spreads(self) -> Table:
        """The distribution of each measure."""
        rows = []
        for s in self.spreads:
            factor, name = find_scale(s.name)
            figures = (f"{value * factor:.3g}" for value in (s.low, s.middle, s.high, s.worst))
            rows.append((name, *figures, str(s.worst_drive)))
        return Table(("measure", "5 %", "median", "95 %", "worst", "in drive"), rows)

    def __str__(self) -> str:
        seconds = sum(row.get("seconds") or 0.0 for row in self.rows)
        lines = [f"drives     {len(self.rows)} of {self.plan.duration:g} s, {seconds:.0f} s driven"]
        varied = ", ".join(self.plan.vary) or "nothing but the seeds"
        lines += wrap(varied, "varied     ", " " * 11)
        if self.worked and self.wall > 0.0:
            speed = self.worked * (seconds / len(self.rows)) / self.wall
            lines.append(f"speed      {speed:.0f} x real time")
        parts = [self.tabulate_ends(), self.tabulate_spreads()]
        if strong := self.list_strongest()[:_SHOWN]:
            found = []
            for s in strong:
                factor, name = find_scale(s.measure)
                moved = (f"{factor * mean:.3g}" for mean in (s.start, s.end))
                found.append((s.quantity, name, *moved, f"{s.value:+.2f}"))
            heads = ("what moves", "what", "from", "to", "rank correlation")
            parts.append(Table(heads, found, words=(1,)))
        return "\n".join([*lines, *(line for part in parts for line in ("", *format_table(part)))])
