"""CPU time of a call, repeated: median and spread. Neighbours are noisy, so no wall time."""

import os
import time
from collections.abc import Callable
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np


class Timed(NamedTuple):
    """Seconds of CPU time per call: median, and the middle 80 % of the repetitions."""

    median: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Timed":
        return Timed(*(factor * value for value in self))


def timed(
    call: Callable[[], object],
    repeats: int = 9,
    least_s: float = 0.02,
    clock: Callable[[], float] = time.process_time,
) -> Timed:
    """Time a call, by CPU time or another clock; short ones are called often enough to be seen."""
    call()
    count = 1
    while (took := _took(call, count, clock)) < least_s:
        count = max(2 * count, int(1.2 * count * least_s / max(took, 1e-6)))
    seconds = [_took(call, count, clock) / count for _ in range(repeats)]
    low, median, high = np.percentile(seconds, [10, 50, 90]).tolist()
    return Timed(median, low, high)


class Point(NamedTuple):
    """A small value, as the programs here make many."""

    x: float
    y: float

    def moved(self, by: float) -> "Point":
        return self._replace(x=self.x + by, y=self.y - by)


def python_unit() -> float:
    """A fixed piece of pure Python: small values, calls, a dictionary. No library.

    Machines and hours differ in how fast Python is; a cost in these units differs less.
    """
    seen: dict[int, float] = {}
    point = Point(0.0, 1.0)
    for i in range(10_000):
        point = point.moved(0.5 if i & 1 else -0.25)
        seen[i & 63] = seen.get(i & 63, 0.0) + point.x * point.y
    return sum(seen.values())


def _took(call: Callable[[], object], count: int, clock: Callable[[], float]) -> float:
    began = clock()
    for _ in range(count):
        call()
    return clock() - began
