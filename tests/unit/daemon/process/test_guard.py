"""The core's side of the guardian."""

import os
import select
import time
from pathlib import Path

import pytest

from steerd.daemon.process.guard import START_NS, ProcessGuard, sleep_lag_ns

BRAKE = b"\x02\x01\x00\x00\x00\x03"


def test_before_a_port_is_open_nothing_may_move_and_nothing_is_missed():
    guard = ProcessGuard(realtime=True)
    now = time.monotonic_ns()
    guard.write_heartbeat(now, engaged=True)
    guard.mark_clean()
    assert not guard.may_write(now, now)
    assert not guard.is_silent(now)
    assert not guard.has_tripped()


@pytest.mark.parametrize(
    ("realtime", "simulated", "stale_ms"),
    [(True, False, 30), (False, False, 60), (True, True, 300)],
)
def test_how_late_a_heartbeat_may_be(realtime, simulated, stale_ms):
    assert ProcessGuard(realtime, simulated=simulated)._stale_ns == stale_ms * 1_000_000


def test_sleep_is_what_the_boot_clock_has_and_the_monotonic_clock_has_not():
    assert sleep_lag_ns() >= -1_000_000
    assert abs(sleep_lag_ns() - sleep_lag_ns()) < 1_000_000_000


@pytest.mark.realtime
def test_a_guardian_shows_itself_brakes_a_silent_core_and_is_missed_when_killed():
    read, write = os.pipe()
    guard = ProcessGuard(realtime=False, simulated=True)
    start = time.monotonic_ns()
    guard.watch(write, BRAKE, start)
    assert not guard.is_silent(start + START_NS - 1), "it has a second to come up"
    assert guard.is_silent(start + START_NS), "and no longer"
    end = time.monotonic() + 20.0
    while not guard._page.guardian_ns and time.monotonic() < end:
        guard.write_heartbeat(time.monotonic_ns(), engaged=False)
        select.select([], [], [], 0.005)
    shown = guard._page.guardian_ns
    assert shown
    assert not guard.is_silent(shown + 300_000_000)
    assert guard.is_silent(shown + 300_000_001)
    now = time.monotonic_ns()
    guard.write_heartbeat(now, engaged=True)
    assert guard.may_write(now, now)
    assert not guard.may_write(now, now + 300_000_000), "a tick of before a stop is not sent after"
    assert select.select([read], [], [], 20.0)[0], "no heartbeat any more: the guardian brakes"
    assert os.read(read, 1000).startswith(BRAKE)
    assert guard.has_tripped()
    assert not guard.may_write(time.monotonic_ns(), time.monotonic_ns())
    guard._process.kill()
    guard._process.wait()
    assert guard.is_silent(time.monotonic_ns())
    os.close(read)
    os.close(write)


@pytest.mark.realtime
def test_a_plug_that_flaps_leaves_nothing_behind():
    read, write = os.pipe()
    guard = ProcessGuard(realtime=False, simulated=True)
    counts = []
    for _ in range(4):
        guard.watch(write, BRAKE, time.monotonic_ns())
        counts.append(len(list(Path("/proc/self/fd").iterdir())))
        guard.mark_clean()
        assert guard._process.wait(20.0) == 0, "let go of, and the car is not armed"
    assert len(set(counts[1:])) == 1
    assert not select.select([read], [], [], 0.0)[0], "nobody braked"
