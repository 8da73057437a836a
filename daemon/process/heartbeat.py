"""What control core and guardian share: a page of memory, and in it notice of the core's death.

The page holds heartbeats, flags and outgoing bytes. A core may be frozen at any instruction, also
between its last look at ``tripped`` and the write itself. So it writes motion frames out of this
page: the kernel reads them during the call, and until then the guardian can make them a brake
frame.

A robust mutex in the page shows the core's end. A pidfd, the end of a pipe or a parent-death
signal report a killed process only after the kernel has freed its memory: 30 to 190 ms were
measured for a core of 140 to 370 MB. The robust futexes of a dying thread are released before that
(``exit_mm_release`` comes first in ``do_exit``). Standard library only; without the C library's
functions the pidfd is used.
"""

import ctypes
import mmap
import select
import time
from typing import Any

OFFSET, MUTEX_BYTES = 64, 64  # of the mutex in the shared page: 40 bytes on x86-64, 48 on arm64
_SHARED = _ROBUST = 1
_OWNER_DIED, _TIMED_OUT = 130, 110


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


def _library() -> Any:
    """The C library, or None where it cannot wait for a mutex by the monotonic clock."""
    library = ctypes.CDLL(None)
    return library if hasattr(library, "pthread_mutex_clocklock") else None


class Lifeline:
    """One end of the mutex: the core holds it until it ends, the guardian waits for it.

    Args:
        page_fd: the shared page.
        core_pidfd: the core, where there is no such mutex; None at the core's own end.
    """

    def __init__(self, page_fd: int, core_pidfd: int | None = None) -> None:
        self._page = mmap.mmap(page_fd, OFFSET + MUTEX_BYTES)
        self._mutex = (ctypes.c_char * MUTEX_BYTES).from_buffer(self._page, OFFSET)
        self._library = _library()
        self._pidfd = select.poll()
        if core_pidfd is not None:
            self._pidfd.register(core_pidfd, select.POLLIN)

    def hold(self) -> None:
        """Core, main thread, before the guardian starts: lock the mutex for this thread's life."""
        if self._library is None:
            return
        kind = (ctypes.c_char * MUTEX_BYTES)()
        self._library.pthread_mutexattr_init(kind)
        self._library.pthread_mutexattr_setpshared(kind, _SHARED)
        self._library.pthread_mutexattr_setrobust(kind, _ROBUST)
        self._library.pthread_mutex_init(self._mutex, kind)
        self._library.pthread_mutex_lock(self._mutex)

    def release(self) -> None:
        """Core: the guardian has ended; remove the mutex from this thread's robust list."""
        if self._library is not None:
            self._library.pthread_mutex_unlock(self._mutex)
        del self._mutex
        self._page.close()

    def poll(self, timeout_ms: int) -> bool:
        """Guardian: wait for `timeout_ms` at most; return whether the core has died."""
        if self._library is not None:
            end_ns = time.monotonic_ns() + timeout_ms * 1_000_000
            until = _Timespec(end_ns // 1_000_000_000, end_ns % 1_000_000_000)
            result: int = self._library.pthread_mutex_clocklock(
                self._mutex, time.CLOCK_MONOTONIC, ctypes.byref(until)
            )
            if result == _TIMED_OUT:
                # A core that left in good order unmapped its page first, with the mutex in it.
                return bool(self._pidfd.poll(0))
            # Held, it would still be on this thread's robust list when the page is unmapped.
            self._library.pthread_mutex_unlock(self._mutex)
            if result == _OWNER_DIED:
                return True
            self._library = None  # the core did not hold it: use the pidfd
        return bool(self._pidfd.poll(timeout_ms))


STALE_NS, STALE_NS_NO_RT = 30_000_000, 60_000_000  # age that trips [ns], with SCHED_FIFO and not
PAUSE_NS = 15_000_000  # between two beats of the guardian [ns]; more is a pause of its own
OUTGOING, OUTGOING_BYTES = OFFSET + MUTEX_BYTES, 256  # a tick that moves the car writes some 60
PAGE_BYTES = OUTGOING + OUTGOING_BYTES


class Words(ctypes.Structure):
    """Integers in shared memory, times by CLOCK_MONOTONIC [ns], 0 for never.

    Each is stored as 8 aligned bytes at once, so no lock is needed.
    """

    heartbeat_ns: int  # core: when it was last alive
    engaged: int  # core: whether motor bytes may flow
    tripped_ns: int  # guardian: when it took over
    guardian_ns: int  # guardian: when it was last alive (W16)
    clean: int  # core: whether the wheels stand, no need to brake when it ends
    pause_from_ns: int  # guardian: its last pause
    pause_to_ns: int  # guardian: the end of that
    _fields_ = tuple((name, ctypes.c_uint64) for name in __annotations__)


class HeartbeatPage:
    """The page of `guard.make_page_fd` as core and guardian use it; both may read ``words``."""

    def __init__(self, fd: int) -> None:
        page = mmap.mmap(fd, PAGE_BYTES)
        self.words, self._outgoing = Words.from_buffer(page), memoryview(page)[OUTGOING:]

    def write_heartbeat(self, t_ns: int, engaged: bool) -> None:
        """Core, each tick before its write: alive at ``t_ns``; motor bytes may flow or not."""
        self.words.heartbeat_ns = t_ns
        self.words.engaged = engaged

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
        return not self.words.tripped_ns and now_ns - tick_ns < stale_ns

    def watch(self, t_ns: int) -> None:
        """Guardian: alive at ``t_ns``."""
        before, self.words.guardian_ns = self.words.guardian_ns, t_ns
        if 0 < before < t_ns - PAUSE_NS:
            self.words.pause_from_ns, self.words.pause_to_ns = before, t_ns

    def trip(self, t_ns: int, brake_frame: bytes) -> None:
        """Guardian: from now on the core must not move the car, and what it has staged brakes.

        Zeros fill the rest: a VESC skips them before the next frame.
        """
        self.words.tripped_ns = t_ns  # first: who stages later looks at it
        self._outgoing[:] = brake_frame.ljust(OUTGOING_BYTES, b"\0")
