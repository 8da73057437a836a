"""One drive of one car, and what the learner said of it when."""

from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time

import numpy as np

from benchmarks.blind_gap.car import make_car
from benchmarks.live_changes.plant import Change, changed, drive
from steerd.car_model.car_file import default_car_path, load_car
from steerd.sim_gap.online.learner import State, fold, make_learner
from steerd.sim_gap.online.naming import Finding
from steerd.sim_gap.online.values import amounts_of

FIRST, LAST = 30.0, 45.0
"""The change comes at a time drawn between these [s]; the car is learnt by 26 s."""
AFTER = 15.0
"""How long the car drives on after it [s]."""


@dataclass(frozen=True, slots=True)
class Said:
    """What was said when, in seconds of the drive; times are NaN where it never was.

    Attributes:
        noticed: when a change was called.
        named: when a name or set was first said, `first` which.
        final: what was said at the end; empty for nothing.
        right: when a right name or set was said that stayed until the end.
        false: changes called before the change (or at all, where there is none).
        value: by how much the effect's first parameter moved, as said at the end; `sd` its standard
            error.
        cpu: processor time per second of driving, the drive's simulation left out.
        peak: largest ratio per what is usual while nothing was called [nats].
    """

    noticed: float
    named: float
    first: tuple[str, ...]
    final: tuple[str, ...]
    right: float
    false: int
    value: float
    sd: float
    cpu: float
    peak: float


def names_of(finding: Finding | None) -> tuple[str, ...]:
    """The name said, and what it cannot be distinguished from; empty where none is."""
    if finding is None or finding.cause is None:
        return ()
    return (finding.cause.effect, *finding.cause.ambiguous_with)


def follow_drive(seed: int, name: str, seconds: float = 0.0) -> Said:
    """Drive and learn.

    Args:
        seed: of the car, the route, the disturbances and the time of the change.
        name: of the change; empty for none.
        seconds: length of a drive without a change [s].
    """
    car = make_car(np.random.default_rng([seed, 1]))
    rng = np.random.default_rng([seed, 2])
    at = round(float(rng.uniform(FIRST, LAST)), 2)
    change = Change(name, at, changed(car, name)) if name else None
    length = at + AFTER if name else seconds
    samples = list(drive(car, length, rng, change))
    learner, state = make_learner(load_car(default_car_path())), State()
    said: list[tuple[float, tuple[str, ...]]] = []
    noticed, false = np.nan, 0
    began = process_time()
    calls: list[float] = []
    for sample in samples:
        before = state
        state, _ = fold(learner, state, sample)
        if state.seen == before.seen:
            continue
        now = sample.t
        if state.change is not None and before.change is None:
            calls.append(now)
        said.append((now, names_of(state.change.finding if state.change else None)))
    cpu = (process_time() - began) / length
    if name:
        false = sum(call < at for call in calls)
        noticed = next((call - at for call in calls if call >= at), np.nan)
    else:
        false = len(calls)
    named, first = next(((t - at, n) for t, n in said if n and t >= at), (np.nan, ()))
    final = said[-1][1] if said else ()
    value, sd = _first_amount(state)
    peak = state.known.peak if state.known else np.nan
    right = _right_since(said, name, at)
    return Said(noticed, named, first, final, right, false, value, sd, cpu, peak)


def _first_amount(state: State) -> tuple[float, float]:
    """By how much the first parameter of what is named now moved, with its standard error."""
    amounts = amounts_of(state.change) if state.change else {}
    value, sd, _ = next(iter(amounts.values()), (np.nan, np.nan, ""))
    return value, sd


def _right_since(said: list[tuple[float, tuple[str, ...]]], name: str, at: float) -> float:
    """From when on what was said held the right name until the end [s after the change]."""
    since = np.nan
    for t, names in said:
        if name not in names or not name:
            since = np.nan
        elif np.isnan(since):
            since = t - at
    return since


def trials(seeds: int, names: list[str]) -> Iterator[tuple[int, str]]:
    """Seeds by changes."""
    for seed in range(seeds):
        for name in names:
            yield seed, name
