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


def _took(call: Callable[[], object], count: int, clock: Callable[[], float]) -> float:
    began = clock()
    for _ in range(count):
        call()
    return clock() - began
