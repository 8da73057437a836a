"""What changed on a car, and on which day: a step in a series of estimates, each with its error.

One value is compared with two, before and after a day; the bound counts the cars, quantities and
days that were asked. The scatter of a car that did not change is that of neighbours in time, so
that a step does not hide itself. Drives that are several times as sure as the middle one know the
car by another model: they have a level of their own (analysis of covariance), or, where they are
too few, count for no more than the middle one. What two values leave beyond the stated errors
widens them (the Birge ratio, as the Particle Data Group's reviews apply it).
"""

# Why: docs/decisions/processes-and-time.md#d103

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import erfc, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.common.screen import clean
from steerd.daemon.many.job import Rows
from steerd.sysid.data.data_checks import Array
from steerd.sysid.report.report import Table

CHANCE = 1e-3  # probability that a batch without any change reports one
LEAST = 6  # drives of a car below which nothing is said about a change
_SIDE = 3  # least drives on either side of a step: of one or two the scatter explains anything
_ROBUST = 1.4826 / sqrt(2.0)
"""Median size of differences of neighbours to the standard deviation of one."""
_DROP = 3.84  # loss of twice the log-likelihood within which a day still may be the one (95 %)
WEEK = 7 * 86_400.0  # [s]
_WIDE = 1.96
_SURER = 3.0
"""A drive whose error is so many times smaller than the middle one's knows it by another model."""
_GROUP = 4  # least such drives, and least others, for a level of their own


@dataclass(frozen=True)
class Series:
    """Estimates of one quantity of one car, in the order of time."""

    car: str  # names of car and quantity
    quantity: str
    start: Array  # of the drives [UNIX s], (n,)
    value: Array  # estimates, (n,)
    sd: Array  # their standard errors, (n,); an unknown one is 0


@dataclass(frozen=True)
class Change:
    """A step in a quantity."""

    car: str  # car and quantity of the series
    quantity: str
    begin: float  # the first drive with the new value [UNIX s]
    earliest: str  # days between which the first one lies (95 %)
    latest: str
    before: float  # mean before it, and after
    after: float
    sd: float  # standard error of their difference
    chance: float  # probability of a step as clear anywhere in the batch, without any change

    @property
    def day(self) -> str:
        """The first day of the new value."""
        return day_of(self.begin)

    @property
    def sigmas(self) -> float:
        """Size of the step in its standard errors."""
        return abs(self.after - self.before) / self.sd


def day_of(start: float) -> str:
    """The day of a time [UNIX s], in UTC."""
    return f"{datetime.fromtimestamp(start, UTC):%Y-%m-%d}"


class Band(NamedTuple):
    """Weekly means of a series with 95 % bands."""

    start: Array  # middle of each week's drives [UNIX s]
    mean: Array
    half: Array  # half the band's width


def list_series(rows: Rows, quantities: Sequence[str]) -> Iterator[Series]:
    """The series of every car and quantity that have enough drives."""
    for car in sorted({str(row["car"]) for row in rows if row.get("car") is not None}):
        own = [row for row in rows if row.get("car") == car and row.get("start") is not None]
        own.sort(key=lambda row: (row["start"], row["session"]))
        for name in quantities:
            known = [row for row in own if row.get(name) is not None]
            if len(known) >= LEAST:
                columns = ([row.get(key) or 0.0 for row in known] for key in ("start", name))
                start, value = (np.array(column, dtype=float) for column in columns)
                sd = np.array([row.get(f"{name}_sd") or 0.0 for row in known])
                yield Series(car, name, start, value, sd)


def find_changes(series: Sequence[Series]) -> list[Change]:
    """Steps that chance does not explain, the clearest first."""
    questions = sum(max(len(s.value) - 2 * _SIDE + 1, 0) for s in series)
    found = [change for s in series if (change := _find_step(s, questions)) is not None]
    return sorted(found, key=lambda change: (change.chance, -change.sigmas))


class _Step(NamedTuple):
    """The fit of a step that begins with a drive: what it says of it."""

    before: float  # level before it
    size: float  # how much larger the values are from it on
    variance: float  # of the size
    spread: float  # weighted squares that are left

    @property
    def gain(self) -> float:
        """Loss of weighted squares by the step, beyond that by the levels alone."""
        return self.size**2 / self.variance


def _find_step(s: Series, questions: int) -> Change | None:
    """The clearest step of a series; None where chance explains it."""
    count = len(s.value)
    weight, levels = _weigh(s)
    begins = range(_SIDE, count - _SIDE + 1)
    if not begins or not np.isfinite(weight.sum()):
        return None
    steps = [_fit_step(s.value, weight, levels, begin) for begin in begins]
    gain = np.array([step.gain for step in steps])
    best = int(np.argmax(gain))
    step, day = steps[best], [day_of(s.start[begin]) for begin in begins]
    birge = max(step.spread / (count - levels.shape[1] - 1), 1.0)
    chance = min(questions * erfc(sqrt(step.gain / birge / 2.0)), 1.0)
    if chance > CHANCE:
        return None
    near = np.flatnonzero(gain >= step.gain - _DROP * birge)
    return Change(
        s.car, s.quantity, float(s.start[_SIDE + best]), day[near[0]], day[near[-1]],
        step.before, step.before + step.size, sqrt(birge * step.variance), chance,
    )  # fmt: skip


def _fit_step(value: Array, weight: Array, levels: Array, begin: int) -> _Step:
    """Weighted least squares of levels and a step; one that only a level could be says nothing."""
    after = (np.arange(len(value)) >= begin).astype(float)
    root = np.sqrt(weight)
    design = np.column_stack([levels, after]) * root[:, None]
    known = np.linalg.matrix_rank(design) == design.shape[1]
    found = np.linalg.lstsq(design, root * value, rcond=None)[0]
    spread = float(np.sum((root * value - design @ found) ** 2))
    variance = float(np.linalg.inv(design.T @ design)[-1, -1]) if known else np.inf
    return _Step(float(found[0]), float(found[-1]), variance, spread)


def _weigh(s: Series) -> tuple[Array, Array]:
    """Weights (n,) of the estimates, and what the levels of surer and other drives are (n, k)."""
    surer = s.sd < np.median(s.sd) / _SURER
    if min(surer.sum(), (~surer).sum()) < _GROUP:
        return _weights(s), np.ones((len(s.value), 1))
    weight = np.empty(len(s.value))
    for group in (surer, ~surer):
        weight[group] = _weights(_part(s, group))
    return weight, np.column_stack([np.ones(len(s.value)), surer])


def _weights(s: Series) -> Array:
    """(n,) weights of the estimates; none more than the middle one."""
    weights: Array = 1.0 / (np.maximum(s.sd, np.median(s.sd)) ** 2 + scatter(s) ** 2)
    return weights


def scatter(s: Series) -> float:
    """Scatter between drives beyond the estimates' own errors; from neighbours in time."""
    if len(s.value) < 2:
        return 1e-9
    steps = np.diff(s.value)
    spread = _ROBUST * float(np.median(np.abs(steps)))
    own = float(np.median(s.sd))
    least = 1e-9 * max(float(np.abs(s.value).max()), 1e-9)
    return max(sqrt(max(spread**2 - own**2, 0.0)), least)


def split_series(s: Series, begin: float) -> list[Series]:
    """The drives before a time [UNIX s] and those from it on: a mean mixes no two cars."""
    return [_part(s, s.start < begin), _part(s, s.start >= begin)]


def _part(s: Series, kept: NDArray[np.bool_]) -> Series:
    return replace(s, start=s.start[kept], value=s.value[kept], sd=s.sd[kept])


def make_band(s: Series) -> Band:
    """Weekly means, counted from the first drive."""
    week = ((s.start - s.start[0]) // WEEK).astype(int)
    weight = _weights(s)
    rows = []
    for number in np.unique(week):
        mine = week == number
        total = weight[mine].sum()
        mean = (weight[mine] * s.value[mine]).sum() / total
        rows.append((s.start[mine].mean(), mean, _WIDE / sqrt(total)))
    return Band(*np.array(rows).T)


def nothing_changed(series: int) -> str:
    """Why no change is named: none was found, or none could be."""
    if not series:
        return f"no car has the {LEAST} drives from which a change could be seen"
    return f"no change beyond what chance explains, in {series} series"


def tabulate_changes(changes: Sequence[Change]) -> Table:
    """A row for each change."""
    heads = ("car", "quantity", "since", "between", "before", "after", "± (difference)", "sigma")
    rows = [
        (
            clean(c.car, 13), clean(c.quantity, 24), c.day, f"{c.earliest} to {c.latest}",
            f"{c.before:.4g}", f"{c.after:.4g}", f"{c.sd:.2g}", f"{c.sigmas:.0f}",
        )
        for c in changes
    ]  # fmt: skip
    return Table(heads, rows, words=(1,))
