import math
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.state import ORIGIN, Command, State
from steerd.estimator import state_filter as sf
from steerd.estimator.config import FilterConfig
from steerd.estimator.initial import make_belief
from steerd.estimator.sensors import Kind, Measurement, make_gyro, make_pose, make_wheel_speed
from steerd.estimator.state_filter import FilterState, predict_to, step

MS = 1_000_000
T0 = 10**12
FILTER = sf.make_state_filter(DEFAULT_CAR)


def standing(flt: sf.StateFilter = FILTER) -> tuple[int, FilterState]:
    """A filter on a car at rest at (1, 2, 0.5)."""
    state = FilterState()
    for k in range(0, 300, 5):
        t = T0 + k * MS
        pose = [make_pose(t - 6 * MS, 1.0, 2.0, 0.5)] if k % 10 == 0 else []
        state = step(flt, state, t, [*pose, make_wheel_speed(t, 0.0)], ((t, Command(0.0, 0.0)),))
    return T0 + 300 * MS, state


def error(state: State[float], truth: State[float]) -> np.ndarray:
    return np.array(state) - np.array(truth)


def altered(drive: Any, change: Callable[[int, Measurement], Measurement | None]) -> Any:
    """The drive with each pose changed or lost; `change` gets its number."""
    number = count()
    told = ((t, change(next(number), m) if m.kind is Kind.POSE else m) for t, m in drive.arrivals)
    return replace(drive, arrivals=[(t, m) for t, m in told if m is not None])


@pytest.fixture
def follow(run_filter):
    """The filter's estimates of a drive and their errors, each within its standard deviations."""

    def follow(measured, truth, most=5.0, settled_ms=130):
        for t, state in run_filter(FILTER, measured):
            estimate = predict_to(FILTER, state, t)
            if estimate is not None and t >= T0 + settled_ms * MS:
                off = error(estimate.state, truth[t])
                assert (np.abs(off) < most * np.array(estimate.sd)).all()
                yield estimate, off

    return follow


def test_nothing_is_known_before_the_first_poses_and_waiting_keeps_nothing_that_grows():
    state = step(FILTER, FilterState(), T0, [make_wheel_speed(T0, 1.0), make_gyro(T0, 0.0)])
    assert predict_to(FILTER, state, T0) is None
    for k in range(9):
        state = step(FILTER, state, T0 + k * MS, (make_pose(T0 + k * MS, 0.0, 0.0, 0.0),))
    assert predict_to(FILTER, state, T0 + 9 * MS) is None
    state = step(FILTER, state, T0 + 9 * MS, (make_pose(T0 + 9 * MS, 0.0, 0.0, 0.0),))
    assert predict_to(FILTER, state, T0 + 8 * MS) is None
    estimate = predict_to(FILTER, state, T0 + 9 * MS)
    assert estimate.health.sound
    assert estimate.health.pose.seen == 10
    state = FilterState()
    for k in range(2000):
        t = T0 + k * 5 * MS
        state = step(FILTER, state, t, [make_wheel_speed(t, 0.0)], ((t, Command(0.0, 0.0)),))
    assert len(state.history.times) < 150
    assert state.first_poses == ()


def test_it_starts_on_a_moving_car_and_follows(drive, follow):
    for _, off in follow(drive, drive.truth):
        assert math.hypot(off[0], off[1]) < 0.006


@pytest.mark.parametrize("shift", [(0.5, 0, 0), (0, -0.5, 0), (0, 0, math.pi), (0, 0, 0.3)])
def test_outliers_and_flips_are_refused_counted_and_harmless(drive, follow, shift):
    def wrong(number: int, m: Measurement) -> Measurement:
        off = np.multiply(shift, number % 20 == 15)
        return m._replace(values=tuple((m.values + off).tolist()))

    poses = sum(m.kind is Kind.POSE for _, m in drive.arrivals)
    expected = len(range(15, poses, 20))
    *_, (estimate, _) = follow(altered(drive, wrong), drive.truth)
    assert expected <= estimate.health.pose.refused <= expected + 2


def test_a_body_swap_is_counted_and_never_moves_the_estimate():
    t, state = standing()
    before = predict_to(FILTER, state, t)
    for k in range(20):
        now = t + k * 10 * MS
        state = step(FILTER, state, now, (make_pose(now, 3.0, 2.0, 0.5),))
    after = predict_to(FILTER, state, now)
    assert after.health.pose.refused == 20
    assert after.health.pose.nis > 1e3
    assert after.health.pose.age_s(after.t_ns) == pytest.approx((now - t + 16 * MS) * 1e-9)
    assert abs(after.state.x - before.state.x) < 0.001
    again = sf.restart_filter(state)
    assert predict_to(FILTER, again, now) is None
    for k in range(20, 30):
        now = t + k * 10 * MS
        again = step(FILTER, again, now, (make_pose(now, 3.0, 2.0, 0.5),))
    assert predict_to(FILTER, again, now).state.x == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("begin", [60, 110, 161])
def test_it_coasts_through_a_gap_of_150_ms(drive, follow, begin):
    gap = altered(drive, lambda number, m: None if begin <= number < begin + 15 else m)
    ages, worst = [], 0.0
    for estimate, off in follow(gap, drive.truth):
        ages.append(estimate.health.pose.age_s(estimate.t_ns))
        worst = max(worst, math.hypot(off[0], off[1]))
        assert estimate.health.position_sd < 0.05
    assert 0.150 < max(ages) < 0.21
    assert worst < 0.06
    assert ages[-1] < 0.03
    assert estimate.health.pose.refused <= 2


def test_without_any_measurement_uncertainty_grows_and_stays_cheap():
    t, state = standing()
    ends = (t + round(seconds * 1e9) for seconds in (0.0, 0.15, 1.0, 600.0))
    found = [predict_to(FILTER, state, end).health for end in ends]
    assert all(health.sound for health in found)
    spread = [(health.position_sd, health.yaw_sd) for health in found]
    assert spread == sorted(spread)
    assert spread[-1][0] > 0.15


def test_standing_for_minutes_stays_bounded():
    t, state = standing()
    rng, at, errors = np.random.default_rng(3), np.array([1.0, 2.0, 0.5]), []
    sds = [FILTER.config.pose_position_sd] * 2 + [FILTER.config.pose_yaw_sd]
    for k in range(2 * 60 * 20):
        now = t + k * 50 * MS
        pose = make_pose(now - 6 * MS, *(at + sds * rng.standard_normal(3)).tolist())
        state = step(FILTER, state, now, [pose, make_wheel_speed(now, 0.0)], ((now, None),))
        if k % 100 == 99:
            estimate = predict_to(FILTER, state, now)
            assert estimate.health.sound
            errors.append(np.array(estimate.state) - [*at, 0.0, 0.0, 0.0, 0.0])
            assert (np.array(estimate.sd)[:6] < [0.002, 0.002, 0.01, 0.1, 0.2, 0.15]).all()
    assert len(state.nodes) < 40
    assert len(state.history.times) < 40
    assert np.abs(errors)[:, :2].max() < 0.006
    assert np.abs(errors)[:, 3:6].max() < 0.2


def test_slow_driving_through_zero(simulate, follow):
    """Forward, through standstill, backwards, and again: where slip angles lose their meaning."""

    def plan(t: float) -> Command[float]:
        return Command(0.15 * math.sin(t), 0.7 * math.cos(1.5 * t))

    drive = simulate(11, 5.0, plan, first=ORIGIN._replace(speed=0.7), config=FILTER.config)
    speeds, nees = [], []
    for estimate, off in follow(drive, drive.truth, 6.0, 200):
        assert estimate.health.sound
        nees.append(off @ np.linalg.solve(estimate.belief.covariance, off))
        speeds.append(estimate.state.speed)
    assert min(speeds) < -0.4
    assert max(speeds) > 0.4
    assert np.mean(nees) < 14.0
    assert estimate.health.pose.refused <= 5


def test_stamp_latency_and_speed_gain_of_the_car_are_honoured(simulate, run_filter):
    car = DEFAULT_CAR._replace(speed_gain=1.1)
    drive, late = simulate(2, 1.5, car=car), {Kind.POSE: 20 * MS}
    flt = sf.make_state_filter(car._replace(pose_delay=0.02))
    told = ((t, m._replace(t_ns=m.t_ns + late.get(m.kind, 0))) for t, m in drive.arrivals)
    arrivals = sorted(((max(t, m.t_ns), m) for t, m in told), key=lambda pair: pair[0])
    *_, (t, state) = run_filter(flt, replace(drive, arrivals=arrivals))
    estimate = predict_to(flt, state, t)
    assert (np.abs(error(estimate.state, drive.truth[t])) < 4.0 * np.array(estimate.sd)).all()


@pytest.mark.parametrize("reference", [False, True], ids=["compiled", "reference"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
def test_nonsense_is_refused(bad, reference):
    flt = sf.make_state_filter(DEFAULT_CAR, reference=reference)
    t, state = standing(flt)
    for m in (make_pose(t, bad, 2.0, 0.5), make_wheel_speed(t, bad), make_gyro(t, bad)):
        state = step(flt, state, t, (m,))
    estimate = predict_to(flt, state, t)
    health = estimate.health
    assert (health.pose.refused, health.wheel_speed.refused, health.gyro.refused) == (1, 1, 1)
    assert health.sound
    assert estimate.state.x == pytest.approx(1.0, abs=1e-6)


def test_measurements_out_of_time_are_not_fused_and_one_that_comes_twice_counts_once():
    t, known = standing()
    before, state = predict_to(FILTER, known, t), known
    for wrong in (t - 700 * MS, t + 3 * MS, t + 10**10):
        state = step(FILTER, state, t, (make_pose(wrong, 1.0, 2.0, 0.5),))
    assert predict_to(FILTER, state, t).state == before.state
    pose = make_pose(t - 8 * MS, 1.0005, 2.0, 0.5)
    once = step(FILTER, known, t, (pose,))
    twice = step(FILTER, once, t, (pose,))
    one, two = predict_to(FILTER, once, t), predict_to(FILTER, twice, t)
    assert (one.state, one.health) == (two.state, two.health)


def test_an_unsound_belief_is_called_so():
    _, state = standing()
    node = state.nodes[-1]
    for hurt in (-1.0, math.nan):
        covariance = node.belief.covariance.copy()
        covariance[3, 3] = hurt
        broken = replace(node, belief=make_belief(node.belief.mean, covariance))
        hurt_state = replace(state, nodes=(*state.nodes[:-1], broken))
        estimate = predict_to(FILTER, hurt_state, node.measurement.t_ns)
        assert not estimate.health.sound
        assert math.isnan(estimate.health.position_sd)
        assert math.isnan(estimate.sd.speed)


# The belief depends on what was measured, not on the order in which it arrived.
FUSING = sf.make_state_filter(DEFAULT_CAR, FilterConfig(history_s=1.0))
COMMANDS = [(T0 + k * 5 * MS, Command(0.1 if k % 40 < 20 else -0.1, 1.5)) for k in range(80)]
POSES = [make_pose(T0 + k * 10 * MS, 0.015 * k, 0.0, 0.0) for k in range(10)]
BEGUN = step(FUSING, FilterState(), T0 + 100 * MS, POSES, COMMANDS)
"""A filter that has seen ten poses of a car driving along x at 1.5 m/s."""
NOW = T0 + 380 * MS


@st.composite
def readings(draw: st.DrawFn) -> list[Measurement]:
    """Readings within 280 ms, some at equal times, some outliers."""
    out = []
    for offset in draw(st.lists(st.integers(1, 280), min_size=1, max_size=12)):
        t = T0 + (95 + offset) * MS
        noise = draw(st.floats(-0.003, 0.003))
        out.append(draw(st.sampled_from([
            make_pose(t, 0.0015 * (95 + offset) + noise, noise, noise), make_pose(t, 7.0, 3.0, 3.0),
            make_wheel_speed(t, 1.5 + 10 * noise), make_gyro(t, 10 * noise),
        ])))  # fmt: skip
    return out


def fed(batches: list[list[Measurement]]) -> sf.StateEstimate:
    state = BEGUN
    for batch in batches:
        state = step(FUSING, state, NOW, batch)
    return predict_to(FUSING, state, NOW)


def same(one: sf.StateEstimate, other: sf.StateEstimate) -> None:
    np.testing.assert_allclose(one.state, other.state, rtol=0.0, atol=1e-9)
    covariances = one.belief.covariance, other.belief.covariance
    np.testing.assert_allclose(*covariances, rtol=1e-9, atol=1e-12)
    assert one.health == other.health or str(one.health) == str(other.health)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(data=st.data(), measured=readings())
def test_any_order_of_arrival_and_division_into_batches_gives_the_same_belief(data, measured):
    shuffled = data.draw(st.permutations(measured))
    same(fed([[m] for m in sorted(measured)]), fed([[m] for m in shuffled]))
    cut = data.draw(st.integers(0, len(measured)))
    same(fed([measured]), fed([measured[cut:], measured[:cut]]))


@settings(derandomize=True, deadline=None, max_examples=30)
@given(data=st.data(), measured=readings())
def test_a_late_command_is_honoured_from_its_time_on(data, measured):
    t = T0 + data.draw(st.integers(100, 370)) * MS
    command = Command(data.draw(st.floats(-0.3, 0.3)), 1.0)
    before = step(FUSING, step(FUSING, BEGUN, NOW, (), [(t, command)]), NOW, measured)
    after = step(FUSING, step(FUSING, BEGUN, NOW, measured), NOW, (), [(t, command)])
    same(predict_to(FUSING, before, NOW), predict_to(FUSING, after, NOW))
