"""Real-time settings of a control process, those that were refused, and a timing check (rtcheck).

Measurements behind each line: `docs/reference/safety-requirements.md#s8`,
`docs/reference/identification.md#i5`.
"""

# Why: docs/decisions/processes-and-time.md#d36

import ctypes
import gc
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.loop.findings import ON_HARDWARE
from steerd.steer_bus.clock import Clock

FIFO_PRIORITY = 50  # under SCHED_FIFO, below the guardian's 60
SWITCH_INTERVAL_S = 0.0005  # longest time for which a thread keeps the interpreter lock [s]
_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3


@dataclass(frozen=True)
class RealtimeReport:
    """What was granted."""

    fifo: bool  # whether the process runs under SCHED_FIFO
    locked: bool  # whether its memory is locked
    refused: tuple[str, ...]  # one line for each refused setting, with the remedy


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _set_fifo(priority: int) -> bool:
    # RESET_ON_FORK: a child under FIFO could starve the core (35-947 ms stalls were measured).
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError:
        return False
    return True


def _lock_memory() -> bool:
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != resource.RLIM_INFINITY and os.geteuid() != 0:
        return False  # locking future pages under a small limit would make allocations fail later
    return bool(_libc().mlockall(_MCL_CURRENT_AND_FUTURE) == 0)


def enter_realtime(priority: int = FIFO_PRIORITY) -> RealtimeReport:
    """Request a fixed priority, locked memory and a fine timer until this process ends."""
    _libc().prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    fifo, locked = _set_fifo(priority), _lock_memory()
    settings = (
        (fifo, "no SCHED_FIFO: other programs may delay the loop", "rtprio 60"),
        (locked, "memory not locked: swapping may delay the loop", "memlock unlimited"),
    )
    refused = tuple(
        f"{what} (add `@dialout - {limit}` to /etc/security/limits.d/steerd.conf)"
        for granted, what, limit in settings
        if not granted
    )
    return RealtimeReport(fifo, locked, refused)


def settle_memory() -> None:
    """Collect garbage once and keep the collector away from what lives now.

    One collection with everything imported takes 100 ms, which is ten ticks.
    """
    gc.collect()
    gc.freeze()
    gc.disable()


P999_LIMIT_NS = 2_000_000  # for one wake of 1000 (`docs/reference/safety-requirements.md#s8.3`)


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


@contextmanager
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
    missed, fatal = (int((late_ns > most).sum()) for most in (period_ns, ON_HARDWARE.late_ns))
    return Wakes(p50, p99, p999, int(late_ns.max()), late_ns.size, missed, fatal)
