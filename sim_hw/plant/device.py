"""Bytes of a simulated device: in flight with their times, and logged for judges.

The split is tickit's: a device holds behaviour, `mocap_link` and `vesc_link` hold the wire formats,
and `links` alone holds sockets. Times are int nanoseconds on whatever monotonic clock the caller
keeps; a device never asks for the time.
"""

from collections import deque
from typing import NamedTuple

from steerd.steer_bus.quick_values import quick_value


@quick_value
class Chunk:
    """Bytes and the time at which they reach the other end [ns]."""

    t_ns: int
    data: bytes


class ByteQueue:
    """Bytes in flight, in order: none overtakes another.

    Attributes:
        next_ns: when the next bytes are due; None without any.
        last_ns: when the last are.
    """

    def __init__(self) -> None:
        self._chunks: deque[Chunk] = deque()
        self.next_ns: int | None = None
        self.last_ns = 0

    def __len__(self) -> int:
        return len(self._chunks)

    def put(self, t_ns: int, data: bytes) -> int:
        """Queue bytes for ``t_ns``, or for when those before them are out; gives that time."""
        if t_ns > self.last_ns:
            self.last_ns = t_ns
        self._chunks.append(Chunk(self.last_ns, data))
        if self.next_ns is None:
            self.next_ns = self.last_ns
        return self.last_ns

    def due(self, t_ns: int) -> list[Chunk]:
        """Take out what is due by ``t_ns``."""
        chunks, out = self._chunks, []
        while chunks and chunks[0].t_ns <= t_ns:
            out.append(chunks.popleft())
        self.next_ns = chunks[0].t_ns if chunks else None
        return out

    def clear(self) -> None:
        """Lose everything that is still in flight."""
        self._chunks.clear()
        self.next_ns = None


class Logged(NamedTuple):
    """One entry of a byte log: ``to`` is ``vesc`` or ``host``."""

    t_ns: int
    to: str
    data: bytes


class ByteLog:
    """Every byte on a link with its time, for judges of what went over the wire.

    Args:
        enabled: False keeps nothing (long soaks).
    """

    def __init__(self, enabled: bool = True) -> None:
        self.enabled = enabled
        self.entries: list[Logged] = []

    def add(self, t_ns: int, to: str, data: bytes) -> None:
        """Note bytes that reached ``to``."""
        if self.enabled:
            self.entries.append(Logged(t_ns, to, data))
