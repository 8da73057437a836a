"""Processor time that the host of a virtual machine took away, from `/proc/stat`."""

import os
from pathlib import Path

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
