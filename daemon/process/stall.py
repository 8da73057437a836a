"""Who made a tick late: the machine's host, the whole machine, or this program alone.

The guardian is the witness: a process of its own, of the highest priority, that wakes every 10 ms.
Where it stood still together with the control core, so did everything.
"""

# Why: docs/decisions/safety.md#d35

import os
from pathlib import Path

from steerd.daemon.loop.flags import Flag
from steerd.daemon.process.guardian import PERIOD_NS

_STAT = Path("/proc/stat")
_STEAL = 8
"""Column of the stolen time in the line of all processors; see proc(5)."""
STALL_SHARE = 0.5
"""A tick is late because the machine stood still if so much of its lateness was stolen."""


def parse_steal(text: str, ticks_per_second: int) -> int:
    """Time stolen from all processors since boot [ns]; 0 where the kernel does not say.

    Args:
        text: of `/proc/stat`.
        ticks_per_second: of the kernel's accounting, mostly 100.
    """
    columns = text.partition("\n")[0].split()
    if len(columns) <= _STEAL or columns[0] != "cpu" or not columns[_STEAL].isdigit():
        return 0
    return int(columns[_STEAL]) * 1_000_000_000 // ticks_per_second


def read_steal_ns() -> int:
    """Time stolen from all processors of this machine since boot [ns]; 0 without `/proc`."""
    try:
        return parse_steal(_STAT.read_text(encoding="ascii"), os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError):
        return 0


def is_stalled(late_ns: int, stolen_ns: int) -> bool:
    """Whether the machine, not this program, made a tick late.

    Args:
        late_ns: lateness of the tick.
        stolen_ns: time stolen since shortly before it was due.
    """
    return late_ns > 0 and stolen_ns >= STALL_SHARE * late_ns


Span = tuple[int, int]
"""From and to [ns]."""
LEAST_NS = 2 * PERIOD_NS
"""Of a shorter delay the guardian, which sleeps for 10 ms, is no witness."""


def find_cause(late: Span, stolen_ns: int, pause: Span | None) -> int:
    """Which flag a late tick gets; 0 where nobody can say.

    Args:
        late: from the time at which the tick was due to the time at which it began.
        stolen_ns: time that the host stole since shortly before it was due.
        pause: the guardian's last pause that was longer than its own sleep, (0, 0) if it never
            made one; None without a guardian.
    """
    length = late[1] - late[0]
    if is_stalled(length, stolen_ns):
        return Flag.STALLED
    if pause is None or length < LEAST_NS:
        return 0
    shared = min(late[1], pause[1]) - max(late[0], pause[0])
    overslept = pause[1] - pause[0] - PERIOD_NS
    if min(shared, overslept) >= STALL_SHARE * length:
        return Flag.ALL_LATE
    return Flag.ALONE_LATE if shared <= 0 else 0
