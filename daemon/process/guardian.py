"""The guardian: a process that brakes the car when the control core dies or freezes.

It holds a duplicate of the serial fd and a page of shared memory for the core's heartbeat. Core
gone, or heartbeat too old while motor bytes may flow: set ``tripped``, then write the brake frame
at once and every 10 ms for 2 s. A core that wakes up again looks at ``tripped`` before each write,
and writes from bytes that the guardian has made a brake frame: no stale motion frame leaves it.
Disarmed, it is silent. Standard library only.
"""

import argparse
import contextlib
import os
import select
import signal
import time
from collections.abc import Callable, Sequence

from steerd.daemon.ipc.signals import wake_at_parents_end
from steerd.daemon.process.heartbeat import HeartbeatPage, Lifeline

PERIOD_NS, BRAKE_NS = 10_000_000, 2_000_000_000  # between brake frames; for so long they go on
PRIORITY = 60  # SCHED_FIFO, above the core's 50


def wait_for_fault(
    page: HeartbeatPage, core: Lifeline, stale_ns: int, now: Callable[[], int]
) -> bool:
    """Watch until the core ends or freezes; return whether to brake the car."""
    while True:
        t_ns = now()
        page.watch(t_ns)
        words, heartbeat_ns = page.words, page.words.heartbeat_ns
        if words.engaged and t_ns - heartbeat_ns > stale_ns:
            return True
        if words.clean and not words.engaged:
            return False
        left_ms = (heartbeat_ns + stale_ns - t_ns) // 1_000_000 + 1 if words.engaged else 10
        if core.poll(max(1, min(10, left_ms))):
            return bool(words.engaged and not words.clean)


def brake(page: HeartbeatPage, serial_fd: int, frame: bytes, now: Callable[[], int]) -> None:
    """Trip, then write the brake frame at once and every 10 ms for 2 s, whatever errors occur."""
    start = now()
    page.trip(start, frame)
    pause = select.poll()
    for due in range(start, start + BRAKE_NS, PERIOD_NS):
        # A full or vanished device answers with OSError; the next frame may get through.
        with contextlib.suppress(OSError):
            os.write(serial_fd, frame)
        page.watch(now())
        pause.poll(max(0, (due + PERIOD_NS - now()) // 1_000_000))


def main(argv: Sequence[str] | None = None) -> None:
    """Guard until the core has ended in good order or the car was braked.

    ``serial_fd`` is a non-blocking duplicate of the core's, ``frame`` a whole brake frame.
    """
    parser = argparse.ArgumentParser(prog="steerd-guardian", description=__doc__)
    for name in ("serial_fd", "page_fd", "core_pidfd"):
        parser.add_argument(name, type=int)
    parser.add_argument("frame", type=bytes.fromhex)
    parser.add_argument("stale_ns", type=int)
    given = parser.parse_args(argv)
    wake_at_parents_end()
    for quiet in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(quiet, signal.SIG_IGN)  # they reach the whole group; the core stops the car
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    page, core = HeartbeatPage(given.page_fd), Lifeline(given.page_fd, given.core_pidfd)
    if wait_for_fault(page, core, given.stale_ns, time.monotonic_ns):
        brake(page, given.serial_fd, given.frame, time.monotonic_ns)


if __name__ == "__main__":
    main()
