"""Independent pieces of compiled work on several threads of this process.

Compiled functions release Python's lock (GIL). As many threads as there are cores for this process,
unless `OMP_NUM_THREADS` says otherwise: joblib and Dask set that for their workers, so that workers
on all cores do not start threads on all cores each. A thread that is ready takes the next piece,
and none waits by spinning: on a busy machine this costs little more than one thread.
"""

# Why: docs/decisions/vehicle-model.md#d57

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

WORTHWHILE = 1000
"""Steps for each thread below which waking it (some 50 us) costs more than it saves."""


def threads() -> int:
    """How many threads may work."""
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, int(stated)) if stated.isdigit() else len(os.sched_getaffinity(0))


@lru_cache(maxsize=1)
def _helpers(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="sysid")


# a forked process inherits the pool but none of its threads
os.register_at_fork(after_in_child=_helpers.cache_clear)


def share_out(work: Callable[[int, int], None], count: int, steps: int) -> None:
    """Do `work(piece, worker)` for all pieces; no two must write the same, other than by worker.

    Args:
        work: a call of a compiled function that releases Python's lock; workers are numbered from
            0, fewer than `threads()`.
        count: pieces.
        steps: how long a piece is, in steps of a simulation.
    """
    most = min(threads(), count, max(1, count * steps // WORTHWHILE))
    if most == 1:
        for i in range(count):
            work(i, 0)
        return

    todo = iter(range(count))

    def part(number: int) -> None:
        for i in todo:
            work(i, number)

    others = [_helpers(threads() - 1).submit(part, number) for number in range(1, most)]
    part(0)
    for other in others:
        if not other.cancel():  # it has not begun: nothing is left for it
            other.result()
