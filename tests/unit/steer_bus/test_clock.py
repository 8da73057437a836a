"""The clock: absolute deadlines and UNIX time."""

import pytest

from steerd.steer_bus.clock import MonotonicClock


@pytest.mark.parametrize("ahead_ns", [-1_000_000, 0, 2_000_000])
def test_monotonic_clock_never_wakes_early(ahead_ns):
    clock = MonotonicClock()
    deadline = clock.now_ns() + ahead_ns
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline


def test_realtime_is_unix_time():
    assert MonotonicClock().realtime_ns() > 1_600_000_000 * 10**9
