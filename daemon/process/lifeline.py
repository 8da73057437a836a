"""Immediate notice of the core's death for the guardian: a robust mutex in their shared page.

A pidfd, the end of a pipe or a parent-death signal report a killed process only after the kernel
has freed its memory: 30 to 190 ms were measured for a core of 140 to 370 MB. The robust futexes of
a dying thread are released before that (``exit_mm_release`` comes first in ``do_exit``). Standard
library only; without the C library's functions the pidfd is used.
"""

import ctypes
import mmap
import select
import time
from typing import Any

OFFSET, MUTEX_BYTES = 64, 64
"""Where the mutex lies in the shared page; it is 40 bytes on x86-64, 48 on arm64."""
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
