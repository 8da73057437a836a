"""The page of memory that control core and guardian share: heartbeats, flags, outgoing bytes.

A core may be frozen at any instruction, also between its last look at ``tripped`` and the write
itself. So it writes motion frames out of this page: the kernel reads them during the call, and
until then the guardian can make them a brake frame. Standard library only.
"""

import mmap

from steerd.daemon.process.lifeline import MUTEX_BYTES, OFFSET

STALE_NS, STALE_NS_NO_RT = 30_000_000, 60_000_000
"""Age of a heartbeat that trips [ns], with SCHED_FIFO or without."""
PAUSE_NS = 15_000_000
"""Between two beats of the guardian [ns]; more is a pause of its own."""
OUTGOING, OUTGOING_BYTES = OFFSET + MUTEX_BYTES, 256
"""Where the outgoing bytes lie; a tick that moves the car writes some 60."""
PAGE_BYTES = OUTGOING + OUTGOING_BYTES
_HEARTBEAT, _ENGAGED, _TRIPPED, _GUARDIAN, _CLEAN, _PAUSE_BEGIN, _PAUSE_END = range(7)


class HeartbeatPage:
    """Seven 8-byte integers in shared memory; each store is aligned, so no lock is needed.

    Core: heartbeat and ``clean``; guardian: the rest. Times: CLOCK_MONOTONIC [ns], 0 for never.
    """

    def __init__(self, fd: int) -> None:
        """Map ``fd`` (a memfd of ``PAGE_BYTES``, see ``guard.make_page_fd``)."""
        page = memoryview(mmap.mmap(fd, PAGE_BYTES))
        # A memoryview of native 'Q' copies 8 aligned bytes at once; struct.pack_into does not.
        self._words = page[:OFFSET].cast("Q")
        self._outgoing = page[OUTGOING:]

    def write_heartbeat(self, t_ns: int, engaged: bool) -> None:
        """Core, each tick before its write: alive at ``t_ns``; motor bytes may flow or not."""
        self._words[_HEARTBEAT] = t_ns
        self._words[_ENGAGED] = engaged

    def stage(self, wire: bytes) -> memoryview:
        """Core, before ``may_write``: the same bytes, where the guardian can still change them.

        Raises:
            ValueError: more than ``OUTGOING_BYTES``.
        """
        if len(wire) > OUTGOING_BYTES:
            raise ValueError(f"a motion frame of {len(wire)} bytes: at most {OUTGOING_BYTES} fit")
        staged = self._outgoing[: len(wire)]
        staged[:] = wire
        return staged

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

    def trip(self, t_ns: int, brake_frame: bytes) -> None:
        """Guardian: from now on the core must not move the car, and what it has staged brakes.

        Zeros fill the rest: a VESC skips them before the next frame.
        """
        self._words[_TRIPPED] = t_ns  # first: who stages later looks at it
        self._outgoing[:] = brake_frame.ljust(OUTGOING_BYTES, b"\0")

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
