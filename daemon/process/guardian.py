"""The guardian: a process that brakes the car when the control core dies or freezes.

It holds a duplicate of the serial fd and a page of shared memory for the core's heartbeat. Core
gone, or heartbeat too old while motor bytes may flow: set ``tripped``, then write the brake frame
at once and every 10 ms for 2 s. A core that wakes up again looks at ``tripped`` before each write:
no stale motion frame leaves it. Disarmed, it is silent. Standard library only.
"""

import argparse
import contextlib
import mmap
import os
import select
import signal
import time
from collections.abc import Callable, Sequence

from steerd.daemon.process.lifeline import MUTEX_BYTES, OFFSET, Lifeline

PAGE_BYTES = OFFSET + MUTEX_BYTES
STALE_NS, STALE_NS_NO_RT = 30_000_000, 60_000_000  # heartbeat age that trips, with FIFO or not
PERIOD_NS, BRAKE_NS = 10_000_000, 2_000_000_000  # between brake frames; for so long they go on
PRIORITY = 60  # SCHED_FIFO, above the core's 50
PAUSE_NS = 15_000_000  # between two beats of the guardian: more is a pause of its own
_HEARTBEAT, _ENGAGED, _TRIPPED, _GUARDIAN, _CLEAN, _PAUSE_BEGIN, _PAUSE_END = range(7)


class HeartbeatPage:
    """Seven 8-byte integers in shared memory; each store is aligned, so no lock is needed.

    Core: heartbeat and ``clean``; guardian: the rest. Times: CLOCK_MONOTONIC [ns], 0 for never.
    """

    def __init__(self, fd: int) -> None:
        """Map ``fd`` (a memfd of ``PAGE_BYTES``, see ``guard.make_page_fd``)."""
        # A memoryview of native 'Q' copies 8 aligned bytes at once; struct.pack_into does not.
        self._words = memoryview(mmap.mmap(fd, PAGE_BYTES)).cast("Q")

    def write_heartbeat(self, t_ns: int, engaged: bool) -> None:
        """Core, each tick before its write: alive at ``t_ns``; motor bytes may flow or not."""
        self._words[_HEARTBEAT] = t_ns
        self._words[_ENGAGED] = engaged

    def may_write(self, tick_ns: int, now_ns: int, stale_ns: int = STALE_NS) -> bool:
        """Core, right before a write: the guardian has not tripped and the tick is still fresh."""
        return not self._words[_TRIPPED] and now_ns - tick_ns < stale_ns

    def mark_clean(self) -> None:
        """Core: the wheels stand; do not brake when the core ends."""
        self._words[_CLEAN] = 1

    def watch(self, t_ns: int) -> None:
        """Guardian: alive at ``t_ns``."""
        before, self._words[_GUARDIAN] = self._words[_GUARDIAN], t_ns
        if 0 < before < t_ns - PAUSE_NS:
            self._words[_PAUSE_BEGIN], self._words[_PAUSE_END] = before, t_ns

    def trip(self, t_ns: int) -> None:
        """Guardian: from now on the core must not move the car."""
        self._words[_TRIPPED] = t_ns

    @property
    def heartbeat_ns(self) -> int:
        """When the core was last alive."""
        return self._words[_HEARTBEAT]

    @property
    def engaged(self) -> bool:
        """Whether motor bytes may flow."""
        return bool(self._words[_ENGAGED])

    @property
    def tripped_ns(self) -> int:
        """When the guardian took over, 0 for never."""
        return self._words[_TRIPPED]

    @property
    def guardian_ns(self) -> int:
        """When the guardian was last alive (W16)."""
        return self._words[_GUARDIAN]

    @property
    def last_pause_ns(self) -> tuple[int, int]:
        """The guardian's last pause, from and to; (0, 0) for none yet."""
        return self._words[_PAUSE_BEGIN], self._words[_PAUSE_END]

    @property
    def clean(self) -> bool:
        """Whether the core left in good order."""
        return bool(self._words[_CLEAN])


def wait_for_fault(
    page: HeartbeatPage, core: Lifeline, stale_ns: int, now: Callable[[], int]
) -> bool:
    """Watch until the core ends or freezes; return whether to brake the car."""
    while True:
        t_ns = now()
        page.watch(t_ns)
        heartbeat_ns = page.heartbeat_ns
        if page.engaged and t_ns - heartbeat_ns > stale_ns:
            return True
        if page.clean and not page.engaged:
            return False
        left_ms = (heartbeat_ns + stale_ns - t_ns) // 1_000_000 + 1 if page.engaged else 10
        if core.poll(max(1, min(10, left_ms))):
            return page.engaged and not page.clean


def brake(page: HeartbeatPage, serial_fd: int, frame: bytes, now: Callable[[], int]) -> None:
    """Trip, then write the brake frame at once and every 10 ms for 2 s, whatever errors occur."""
    start = now()
    page.trip(start)
    pause = select.poll()
    for due in range(start, start + BRAKE_NS, PERIOD_NS):
        # A full or vanished device answers with OSError; the next frame may get through.
        with contextlib.suppress(OSError):
            os.write(serial_fd, frame)
        page.watch(now())
        pause.poll(max(0, (due + PERIOD_NS - now()) // 1_000_000))


def guardian_main(
    serial_fd: int, page_fd: int, core_pidfd: int, frame: bytes, stale_ns: int = STALE_NS
) -> None:
    """Guard until the core has ended in good order or the car was braked.

    ``serial_fd`` is a non-blocking duplicate of the core's, ``frame`` a whole brake frame.
    """
    for quiet in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(quiet, signal.SIG_IGN)  # they reach the whole group; the core stops the car
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    page, core = HeartbeatPage(page_fd), Lifeline(page_fd, core_pidfd)
    if wait_for_fault(page, core, stale_ns, time.monotonic_ns):
        brake(page, serial_fd, frame, time.monotonic_ns)


def main(argv: Sequence[str] | None = None) -> None:
    """``python -m steerd.daemon.process.guardian SERIAL_FD PAGE_FD PIDFD FRAME_HEX STALE_NS``."""
    parser = argparse.ArgumentParser(prog="steerd-guardian", description=__doc__)
    for name in ("serial_fd", "page_fd", "core_pidfd"):
        parser.add_argument(name, type=int)
    parser.add_argument("frame", type=bytes.fromhex)
    parser.add_argument("stale_ns", type=int)
    guardian_main(**vars(parser.parse_args(argv)))


if __name__ == "__main__":
    main()
