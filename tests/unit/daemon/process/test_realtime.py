"""Real-time settings: what is refused is reported with its remedy, and nothing else is."""

import gc
import os
import sys
from pathlib import Path

import pytest

from steerd.daemon.process import realtime


class Libc:
    """A C library that locks memory or refuses to."""

    def __init__(self, locked):
        self.locked = locked

    def prctl(self, *_args):
        return 0

    def mlockall(self, _flags):
        return 0 if self.locked else -1


@pytest.fixture
def machine(monkeypatch):
    """Sets what the machine grants; the interpreter's switch interval comes back afterwards."""
    asked = []
    interval = sys.getswitchinterval()

    def grant(fifo, locked, limit=realtime.resource.RLIM_INFINITY):
        def schedule(_pid, policy, parameters):
            asked.append((policy, parameters.sched_priority))
            if not fifo:
                raise PermissionError

        monkeypatch.setattr(realtime.os, "sched_setscheduler", schedule)
        monkeypatch.setattr(realtime.os, "geteuid", lambda: 1000)
        monkeypatch.setattr(realtime.resource, "getrlimit", lambda _which: (limit, limit))
        monkeypatch.setattr(realtime, "_libc", lambda: Libc(locked))
        return asked

    yield grant
    sys.setswitchinterval(interval)


@pytest.mark.parametrize(("fifo", "locked"), [(True, True), (True, False), (False, False)])
def test_each_refusal_has_a_line_with_its_remedy(machine, fifo, locked):
    machine(fifo, locked)
    report = realtime.enter_realtime()
    assert (report.fifo, report.locked) == (fifo, locked)
    assert [("SCHED_FIFO" in line, "memlock" in line) for line in report.refused] == (
        [(True, False)] * (not fifo) + [(False, True)] * (not locked)
    )
    assert all("/etc/security/limits.d/" in line for line in report.refused)
    assert sys.getswitchinterval() == pytest.approx(realtime.SWITCH_INTERVAL_S)


def test_children_do_not_inherit_the_priority(machine):
    asked = machine(fifo=True, locked=True)
    realtime.enter_realtime(42)
    ((policy, priority),) = asked
    assert policy & realtime.os.SCHED_RESET_ON_FORK
    assert priority == 42


def test_under_a_small_limit_memory_is_not_locked(machine):
    """A lock of future pages would then make later allocations fail."""
    machine(fifo=True, locked=True, limit=65536)
    assert not realtime.enter_realtime().locked


def test_the_collector_stays_away_from_what_lives_now():
    try:
        realtime.settle_memory()
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
        gc.enable()


def test_real_time_for_a_while_leaves_nothing_behind():
    """Tests run commands in their own process: rtcheck once left it at a fixed priority."""

    def standing():
        status = Path("/proc/self/status").read_text().splitlines()
        locked = next(line for line in status if line.startswith("VmLck"))
        return (
            gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval(),
            os.sched_getscheduler(0), locked,
        )  # fmt: skip

    before = standing()
    with realtime.realtime_section() as report:
        assert not gc.isenabled()
        assert (os.sched_getscheduler(0) & os.SCHED_FIFO != 0) == report.fifo
    assert standing() == before
