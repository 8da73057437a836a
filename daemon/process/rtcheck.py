"""Timing check of this machine: wake times of an empty loop against absolute deadlines."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.loop.lateness import ON_HARDWARE
from steerd.steer_bus.clock import Clock

P999_LIMIT_NS = 2_000_000
"""One wake of 1000 may be this late (`docs/reference/safety-requirements.md#s8.3`)."""


class Wakes(NamedTuple):
    """Statistics of the lateness of an empty loop."""

    p50_ns: int  # lateness of its wakes, as the next three
    p99_ns: int
    p999_ns: int
    worst_ns: int
    ticks: int  # how many there were
    missed: int  # those later than one period; such a tick is skipped
    fatal: int  # those later than what stops a car at once (W15)

    @property
    def good(self) -> bool:
        """Whether a car may be driven on this machine, as loaded now."""
        return self.missed == 0 and self.p999_ns < P999_LIMIT_NS


@contextlib.contextmanager
def keep_busy(count: int) -> Iterator[None]:
    """Run so many processes that do nothing but compute, at ordinary priority."""
    command = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(command) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def measure_wakes(clock: Clock, period_ns: int, ticks: int) -> NDArray[np.int64]:
    """Lateness of each wake [ns], shape (ticks,); a missed deadline is skipped, never caught up."""
    late = np.zeros(ticks, np.int64)
    due = clock.now_ns() + period_ns
    for k in range(ticks):
        clock.sleep_until_ns(due)
        late[k] = clock.now_ns() - due
        due += period_ns * (1 + int(late[k]) // period_ns)
    return late


def summarise_wakes(late_ns: NDArray[np.int64], period_ns: int) -> Wakes:
    """Statistics of wake lateness, shape (n,) with n > 0 [ns]."""
    p50, p99, p999 = (int(np.percentile(late_ns, share)) for share in (50, 99, 99.9))
    return Wakes(
        p50,
        p99,
        p999,
        int(late_ns.max()),
        late_ns.size,
        int((late_ns > period_ns).sum()),
        int((late_ns > ON_HARDWARE.late_ns).sum()),
    )
