"""Deadlines follow punctual poses, and nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.daemon.process.pacing import MARGIN, SLEW, STEADY, Pace, early_window_ns, step_pace

MS = 1_000_000
TICKS = 2000


def drive(period, frames, ticks=TICKS):
    """Deadlines, and for each the wait of the newest frame, which comes at the given times."""
    pace, due, newest, coming = Pace(), 0, -1, 0
    dues, waits, paces = [], [], []
    for _ in range(ticks):
        while coming < len(frames) and frames[coming] <= due:
            newest, coming = frames[coming], coming + 1
        pace = step_pace(pace, due, newest, period)
        dues.append(due)
        waits.append(due - newest)
        paces.append(pace)
        due += period + pace.shift_ns
    return dues, waits, paces


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


@pytest.mark.parametrize("period_ms", [2, 5, 10])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_only_the_pose_that_belongs_to_a_deadline_makes_its_tick(period_ms, ratio):
    period = period_ms * MS
    frames = arrivals(period * ratio, 0.4, 0.02 * MS, 12)
    dues, waits, paces = drive(period, frames)
    stretch = range(TICKS // 2, TICKS - 1)
    room = {early_window_ns(paces[k], period) for k in stretch}
    assert max(room) < period // 2
    early = [[due - f for f in frames if due - period < f <= due] for due in dues[-200:]]
    for lead, pace in zip(early[1:], paces[-200:-1], strict=True):
        assert sum(wait <= early_window_ns(pace, period) for wait in lead) <= 1
    fresh = [waits[k + 1] for k in stretch if waits[k + 1] < period / 2]
    assert all(wait <= min(room) for wait in fresh)


@given(jitter=st.floats(0.0, 1e9), period=st.integers(MS, 20 * MS))
def test_no_pose_is_early_by_more_than_half_a_period(jitter, period):
    assert 0 <= early_window_ns(Pace(0, 0, jitter, steady=STEADY), period) <= period // 2
