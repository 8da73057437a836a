"""The only clocks: monotonic nanoseconds for control, UNIX nanoseconds for stamps.

Runners and transports are given a :class:`Clock`; everything below them is given ``t_ns``.
"""

import time
from typing import Protocol


class Clock(Protocol):
    """Where a runner gets its time from."""

    def now_ns(self) -> int:
        """Give CLOCK_MONOTONIC in nanoseconds."""

    def realtime_ns(self) -> int:
        """Give nanoseconds since the UNIX epoch; may step when the host's clock is set."""

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at the absolute monotonic ``deadline_ns``, at once if it has passed."""


class MonotonicClock:
    """The host's clock."""

    now_ns = staticmethod(time.monotonic_ns)
    """CLOCK_MONOTONIC in nanoseconds; itself, because a tick asks a dozen times."""

    realtime_ns = staticmethod(time.time_ns)  # CLOCK_REALTIME in nanoseconds

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep to an absolute deadline, so that a late tick never delays the next."""
        while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns * 1e-9)  # noqa: TID251
