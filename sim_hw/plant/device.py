"""Bytes of a simulated device: in flight with their times, and logged for judges.

The split is tickit's: a device holds behaviour, `mocap_link` and `vesc_link` hold the wire formats,
and `links` alone holds sockets. Times are int nanoseconds on whatever monotonic clock the caller
keeps; a device never asks for the time.
"""

from typing import NamedTuple

from steerd.steer_bus.quick_values import quick_value


@quick_value
class Chunk:
    """Bytes and the time at which they reach the other end [ns]."""

    t_ns: int
    data: bytes


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
