"""Deadlines follow punctual poses, and nothing else; real time: what is refused, who was late."""

import os
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.daemon.loop.findings import Flag
from steerd.daemon.process import realtime
from steerd.daemon.process.guard import LEAST_NS, find_cause, parse_steal
from steerd.daemon.process.guardian import PERIOD_NS
from steerd.daemon.process.pacing import MARGIN, SLEW, STEADY, Pace, early_window_ns, step_pace
from steerd.daemon.process.realtime import measure_wakes, summarise_wakes

MS = 1_000_000
TICKS = 2000


def drive(period, frames, ticks=TICKS):
    """Deadlines, the wait of the newest frame at each, and paces; frames come at given times."""
    pace, due, newest, coming, seen = Pace(), 0, -1, 0, []
    for _ in range(ticks):
        while coming < len(frames) and frames[coming] <= due:
            newest, coming = frames[coming], coming + 1
        pace = step_pace(pace, due, newest, period)
        seen.append((due, due - newest, pace))
        due += period + pace.shift_ns
    return zip(*seen, strict=True)


def arrivals(every, phase, jitter, seed, share=1.0):
    draw = np.random.default_rng(seed)
    count = int(TICKS * 11 * MS / every)
    times = (np.arange(count) + phase) * every + np.abs(draw.normal(0.0, jitter, count))
    return times[draw.random(count) < share].round().astype(int).tolist()


PHASES = (0.02, 0.3, 0.5, 0.7, 0.98)


@pytest.mark.parametrize(("period_ms", "ratio", "phase", "share", "late_ms"), [
    *((period_ms, 1.0, phase, 1.0, 0.2) for period_ms in (2, 5, 10) for phase in PHASES),
    (5, 0.5, 0.4, 1.0, 0.2), (5, 2.0, 0.4, 1.0, 0.2),  # twice or half as often
    (10, 1.0, 0.3, 0.8, 0.2),  # lost poses do not move what is in step
    (10, 1.0 / 1.002, 0.3, 1.0, 0.5),  # a mocap clock that is a little fast
])  # fmt: skip
def test_a_punctual_pose_comes_shortly_before_its_deadline(period_ms, ratio, phase, share, late_ms):
    period = period_ms * MS
    dues, waits, _ = drive(period, arrivals(period * ratio, phase, 0.02 * MS, 5, share))
    settled = np.array(waits[TICKS // 2 :])
    assert settled.min() > 0
    assert np.quantile(settled % period, 0.99) < MARGIN * period + late_ms * MS
    assert np.mean(settled < period) > 0.7 * min(share, 1.0 / ratio)
    followed = 1.0 if ratio in (0.5, 2.0) else ratio
    assert np.diff(dues[TICKS // 2 :]).mean() / period == pytest.approx(followed, rel=2e-4)


@pytest.mark.parametrize(("period_ms", "every", "jitter"), [
    *((10, 1e9 / hz, 0.02 * MS) for hz in (120, 240, 360, 1000 / 7.3)),
    (5, 1e9 / 120, 0.0), (5, 5 * MS, 1.5 * MS),
])  # fmt: skip
def test_poses_without_a_common_rhythm_move_nothing_and_make_no_ticks(period_ms, every, jitter):
    period = period_ms * MS
    dues, _, paces = drive(period, arrivals(every, 0.3, jitter, 9))
    assert np.ptp(np.diff(dues[50:])) == 0
    assert {early_window_ns(pace, period) for pace in paces[50:]} == {0}


def test_without_poses_and_when_they_end_the_period_is_the_nominal_one():
    period = 10 * MS
    for frames, settled in (([], 0), (arrivals(period, 0.9, 0.0, 11)[:300], 302)):
        dues, _, paces = drive(period, frames)
        assert set(np.diff(dues[settled:])) == {period}
        assert (paces[-1].arrival_ns == -1) is (not frames)
    assert early_window_ns(Pace(), period) == 0


@given(
    period=st.integers(MS, 20 * MS),
    steps=st.lists(st.integers(0, 40 * MS), min_size=1, max_size=60),
)
def test_no_arrivals_whatever_bend_a_period_by_more_than_the_slew(period, steps):
    dues, _, _ = drive(period, np.cumsum(steps).tolist(), 80)
    assert np.abs(np.diff(dues) - period).max() <= SLEW * period + 1


@given(jitter=st.floats(0.0, 1e9), period=st.integers(MS, 20 * MS))
def test_no_pose_is_early_by_more_than_half_a_period(jitter, period):
    assert 0 <= early_window_ns(Pace(0, 0, jitter, steady=STEADY), period) <= period // 2


# Real time: settings that a machine refuses, and who made a tick late.
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
        libc = SimpleNamespace(prctl=lambda *_: 0, mlockall=lambda _flags: 0 if locked else -1)
        monkeypatch.setattr(realtime, "_libc", lambda: libc)
        return asked

    yield grant
    sys.setswitchinterval(interval)


@pytest.mark.parametrize(("fifo", "locked"), [(True, True), (True, False), (False, False)])
def test_each_refusal_has_a_line_with_its_remedy(machine, fifo, locked):
    asked = machine(fifo, locked)
    report = realtime.enter_realtime(42)
    assert asked == [(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 42)], "children do not inherit it"
    assert (report.fifo, report.locked) == (fifo, locked)
    assert [("SCHED_FIFO" in line, "memlock" in line) for line in report.refused] == (
        [(True, False)] * (not fifo) + [(False, True)] * (not locked)
    )
    assert all("/etc/security/limits.d/" in line for line in report.refused)
    assert sys.getswitchinterval() == pytest.approx(realtime.SWITCH_INTERVAL_S)


def test_under_a_small_limit_memory_is_not_locked(machine):
    """A lock of future pages would then make later allocations fail."""
    machine(fifo=True, locked=True, limit=65536)
    assert not realtime.enter_realtime().locked


# Who made a tick late is told from the guardian's pause: machine, host, or this program alone.
START = 10**12
JUST = LEAST_NS // MS
NEVER = -START // MS, -START // MS  # no pause, as the page says it: from 0 to 0 [ns]


@pytest.mark.parametrize(("late_ms", "pause_ms", "stolen_ms", "flag"), [
    # A stall of all, which began `due` before the core's tick, `slept` after the guardian's beat.
    *((round(stall - due), (-due - slept, stall - due + 1), 0, Flag.ALL_LATE)
      for stall in (31, 40, 60, 200) for due in (0, 5, 9.9) for slept in (0, 3, 9.9)),
    # A pause at another time, or none: the guardian ran all the time.
    *((41, pause, 0, Flag.ALONE_LATE) for pause in ((-900, -850), (-40, 0), (60, 90), NEVER)),
    (JUST, NEVER, 0, Flag.ALONE_LATE), (41, None, 0, 0),  # nobody saw it
    (100, (-10, 30), 0, 0), (100, (90, 120), 0, 0),  # the guardian ran for most of it
    # Of a short delay it is no witness.
    (0, (-5, 5), 0, 0), (JUST - 1, (0, 0), 0, 0), (JUST - 1, (-9, JUST), 0, 0),
    (JUST, (0, PERIOD_NS // MS + 9), 0, 0),  # mostly its own sleep
    # Stolen time says more than the guardian.
    (40, (-5, 45), 40, Flag.STALLED), (40, (0, 0), 20, Flag.STALLED),
    (40, (-5, 45), 19, Flag.ALL_LATE),
])  # fmt: skip
def test_who_made_a_tick_late(late_ms, pause_ms, stolen_ms, flag):
    """It is late from 0 on; the guardian's pause is from and to."""
    pause = pause_ms and tuple(START + round(t * MS) for t in pause_ms)
    assert find_cause((START, START + late_ms * MS), stolen_ms * MS, pause) == flag


STAT = "cpu  10 0 5 900 1 0 0 42 0 0\ncpu0 10 0 5 900 1 0 0 42 0 0\n"


def test_stolen_time_of_all_processors():
    assert parse_steal(STAT, 100) == 420 * MS
    for other in ("cpu 1 2 3 4\n", "", "intr 1 2 3 4 5 6 7 8 9\n", "cpu 1 2 3 4 5 6 7 x 9\n"):
        assert parse_steal(other, 100) == 0, other


def test_a_missed_deadline_is_skipped_and_never_caught_up():
    late, deadlines, now = [0, 25 * MS, 1 * MS], [], [0]

    def sleep(deadline_ns):
        now[0] = deadline_ns + late[len(deadlines)]
        deadlines.append(deadline_ns)

    clock = SimpleNamespace(now_ns=lambda: now[0], sleep_until_ns=sleep)
    assert measure_wakes(clock, 10 * MS, 3).tolist() == late
    assert deadlines == [10 * MS, 20 * MS, 50 * MS]


@pytest.mark.parametrize(("few", "more", "good", "missed", "fatal"), [
    (1000, [], True, 0, 0), (998, [9.0, 9.0], False, 0, 0), (9999, [10.0], True, 0, 0),
    (9999, [10.1], False, 1, 0), (9999, [25.1], False, 1, 1),
])  # fmt: skip
def test_what_is_good_enough(few, more, good, missed, fatal):
    late_ms = [0.1] * few + more
    wakes = summarise_wakes((np.array(late_ms) * MS).astype(np.int64), 10 * MS)
    assert (wakes.good, wakes.missed, wakes.fatal) == (good, missed, fatal)
    assert (wakes.ticks, wakes.worst_ns) == (len(late_ms), round(max(late_ms) * MS))
