"""Clocks: absolute deadlines, and virtual time that never goes back."""

import pytest

from steerd.steer_bus.clock import MonotonicClock, VirtualClock


def test_virtual_clock_jumps_to_the_deadline():
    clock = VirtualClock(epoch_ns=1000)
    clock.sleep_until_ns(5_000_000)
    assert clock.now_ns() == 5_000_000
    assert clock.realtime_ns() == 5_001_000


def test_virtual_clock_never_goes_back():
    clock = VirtualClock(t_ns=10)
    clock.sleep_until_ns(3)
    assert clock.now_ns() == 10


@pytest.mark.parametrize("ahead_ns", [-1_000_000, 0, 2_000_000])
def test_monotonic_clock_never_wakes_early(ahead_ns):
    clock = MonotonicClock()
    deadline = clock.now_ns() + ahead_ns
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline


def test_realtime_is_unix_time():
    assert MonotonicClock().realtime_ns() > 1_600_000_000 * 10**9
