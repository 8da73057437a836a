"""Who made a tick late: the machine's host, the whole machine, or this program alone.

The guardian is the witness: a process of its own, of the highest priority, that wakes every 10 ms.
Where it stood still together with the control core, so did everything.
"""

# Why: docs/decisions/safety.md#d35

from steerd.daemon.loop.flags import Flag
from steerd.daemon.process.guardian import PERIOD_NS
from steerd.daemon.process.steal import STALL_SHARE, is_stalled

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
