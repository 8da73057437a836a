"""The belief depends on what was measured, not on the order in which it arrived."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.state import Command
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import Measurement, make_gyro, make_pose, make_wheel_speed
from steerd.estimator.state_filter import (
    FilterState,
    StateEstimate,
    make_state_filter,
    predict_to,
    step,
)

MS = 1_000_000
T0 = 10**12
FILTER = make_state_filter(DEFAULT_CAR, FilterConfig(history_s=1.0))


def commands() -> list[tuple[int, Command[float] | None]]:
    return [(T0 + k * 5 * MS, Command(0.1 if k % 40 < 20 else -0.1, 1.5)) for k in range(80)]


def begun() -> FilterState:
    """A filter that has seen ten poses of a car driving along x at 1.5 m/s."""
    poses = [make_pose(T0 + k * 10 * MS, 0.015 * k, 0.0, 0.0) for k in range(10)]
    return step(FILTER, FilterState(), T0 + 100 * MS, poses, commands())


BEGUN = begun()
NOW = T0 + 380 * MS


@st.composite
def readings(draw: st.DrawFn) -> list[Measurement]:
    """Readings within 280 ms, some at equal times, some outliers."""
    out = []
    for offset in draw(st.lists(st.integers(1, 280), min_size=1, max_size=12)):
        t = T0 + (95 + offset) * MS
        noise = draw(st.floats(-0.003, 0.003))
        match draw(st.sampled_from(["pose", "outlier", "wheel", "gyro"])):
            case "pose":
                out.append(make_pose(t, 0.0015 * (95 + offset) + noise, noise, noise))
            case "outlier":
                out.append(make_pose(t, 7.0, 3.0, 3.0))
            case "wheel":
                out.append(make_wheel_speed(t, 1.5 + 10 * noise))
            case _:
                out.append(make_gyro(t, 10 * noise))
    return out


def fed(batches: list[list[Measurement]]) -> StateEstimate:
    state = BEGUN
    for batch in batches:
        state = step(FILTER, state, NOW, batch)
    estimate = predict_to(FILTER, state, NOW)
    assert estimate is not None
    return estimate


def same(one: StateEstimate, other: StateEstimate) -> None:
    np.testing.assert_allclose(one.state, other.state, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        one.belief.covariance, other.belief.covariance, rtol=1e-9, atol=1e-12
    )
    assert one.health == other.health or str(one.health) == str(other.health)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(data=st.data(), measured=readings())
def test_any_order_of_arrival_gives_the_same_belief(data, measured):
    shuffled = data.draw(st.permutations(measured))
    same(fed([[m] for m in sorted(measured)]), fed([[m] for m in shuffled]))


@settings(derandomize=True, deadline=None, max_examples=30)
@given(data=st.data(), measured=readings())
def test_any_division_into_batches_gives_the_same_belief(data, measured):
    cut = data.draw(st.integers(0, len(measured)))
    same(fed([measured]), fed([measured[cut:], measured[:cut]]))


@settings(derandomize=True, deadline=None, max_examples=30)
@given(data=st.data(), measured=readings())
def test_a_late_command_is_honoured_from_its_time_on(data, measured):
    t = T0 + data.draw(st.integers(100, 370)) * MS
    command = Command(data.draw(st.floats(-0.3, 0.3)), 1.0)
    before = step(FILTER, step(FILTER, BEGUN, NOW, (), [(t, command)]), NOW, measured)
    after = step(FILTER, step(FILTER, BEGUN, NOW, measured), NOW, (), [(t, command)])
    one, other = predict_to(FILTER, before, NOW), predict_to(FILTER, after, NOW)
    assert one is not None
    assert other is not None
    same(one, other)
