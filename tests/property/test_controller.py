"""Lane errors and the output limiter: what they promise for any place and any sequence."""

import math
from math import inf, isfinite, tan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import derivative
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import Path, project
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command, State
from steerd.controller.lane_keeper import LaneErrors, lane_errors
from steerd.controller.limits import Limits, Verdict, limit_order, make_limiter_state

EIGHT = parse_path("figure8")
LEFT, RIGHT = parse_path("circle:radius=1.4"), parse_path("circle:radius=-1.4")

SHARES = st.floats(0.05, 0.95)
OFFSETS = st.floats(-0.3, 0.3)
HEADINGS = st.floats(-0.8, 0.8)
SPEEDS = st.floats(0.0, 4.0)
YAW_RATES = st.floats(-3.0, 3.0)
SLIPS = st.floats(-0.2, 0.2)


def beside(path: Path, share: float, e1: float, e2: float) -> tuple[int, float, float, float]:
    i = int(share * len(path.x))
    yaw = path.yaw[i]
    return i, path.x[i] - e1 * math.sin(yaw), path.y[i] + e1 * math.cos(yaw), yaw + e2


def errors_at(path: Path, state: State[float], hint: int) -> LaneErrors:
    return lane_errors(state, project(path, state.x, state.y, hint))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(SHARES, OFFSETS, HEADINGS, SPEEDS, YAW_RATES, SLIPS)
def test_rates_are_the_derivatives_of_the_errors(share, e1, e2, speed, yaw_rate, slip):
    hint, x, y, yaw = beside(EIGHT, share, e1, e2)
    state = State(x, y, yaw, speed, yaw_rate, slip, 0.0)
    rates = derivative(SINGLE_TRACK, FLOAT, DEFAULT_CAR, state, 0.0, 0.0)
    h = 1e-3

    def moved(by: float) -> LaneErrors:
        there = state._replace(x=x + by * rates.x, y=y + by * rates.y, yaw=yaw + by * rates.yaw)
        return errors_at(EIGHT, there, hint)

    before, now, after = moved(-h), errors_at(EIGHT, state, hint), moved(h)
    assert now.e1_rate == pytest.approx((after.e1 - before.e1) / (2.0 * h), abs=2e-3)
    assert now.e2_rate == pytest.approx((after.e2 - before.e2) / (2.0 * h), abs=2e-2)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(SHARES, OFFSETS, HEADINGS, SPEEDS, YAW_RATES, SLIPS)
def test_left_is_the_mirror_image_of_right(share, e1, e2, speed, yaw_rate, slip):
    hint, x, y, yaw = beside(LEFT, share, e1, e2)
    left = errors_at(LEFT, State(x, y, yaw, speed, yaw_rate, slip, 0.0), hint)
    right = errors_at(RIGHT, State(x, -y, -yaw, speed, -yaw_rate, -slip, 0.0), hint)
    assert right == pytest.approx(tuple(-value for value in left), abs=1e-9)


# What the output limiter promises for any sequence of orders.

FAST = settings(derandomize=True, deadline=None, max_examples=300)
limits_ = st.builds(
    Limits,
    wheelbase=st.floats(0.1, 0.6),
    steer_left_max=st.floats(0.05, 0.6),
    steer_right_max=st.floats(0.05, 0.6),
    steer_rate_max=st.floats(0.1, 3.2),
    speed_max=st.floats(0.1, 6.0),
    accel_max=st.floats(0.1, 2.5),
    decel_max=st.floats(1.5, 6.0),
    lateral_accel_max=st.floats(0.1, 3.0),
)
anything = st.floats(allow_nan=True, allow_infinity=True)
orders = st.tuples(
    st.one_of(anything, st.floats(-1, 1)),
    st.one_of(anything, st.floats(-1, 8)),
    st.one_of(anything, st.floats(-1, 8)),  # measured speed
    st.one_of(st.just(inf), st.floats(0, 6)),  # cap
    st.integers(-(10**7), 5 * 10**7),  # step [ns]
)


@FAST
@given(limits_, st.lists(orders, max_size=30))
def test_every_output_of_any_sequence_is_finite_within_limits_and_rates(limits, sequence):
    state, t_ns = make_limiter_state(limits, Command(0.0, 0.0), 0), 0
    for steer, speed, measured, cap, step_ns in sequence:
        t_ns += step_ns
        dt = min(max((t_ns - state.t_ns) * 1e-9, 0.0), limits.step_max)
        out = limit_order(limits, state, Command(steer, speed), measured, cap, t_ns)
        finite = isfinite(steer) and isfinite(speed) and isfinite(measured)
        assert (out.verdict == Verdict.NOT_FINITE) == (not finite)
        assert -limits.steer_right_max <= out.order.steer <= limits.steer_left_max
        assert 0.0 <= out.order.speed <= limits.speed_max
        assert abs(out.order.steer - state.order.steer) <= limits.steer_rate_max * dt + 1e-15
        assert out.order.speed - state.order.speed <= limits.accel_max * dt + 1e-15
        assert state.order.speed - out.order.speed <= limits.decel_max * dt + 1e-15
        state = out.state


@FAST
@given(limits_, st.floats(-0.6, 0.6), st.floats(0, 6), orders)
def test_twice_is_once(limits, last_steer, last_speed, wish):
    steer, speed, measured, cap, step_ns = wish
    state = make_limiter_state(limits, Command(last_steer, last_speed), 0)
    once = limit_order(limits, state, Command(steer, speed), measured, cap, step_ns)
    again = limit_order(
        limits, state, once.order, measured if isfinite(measured) else 0.0, cap, step_ns
    )
    if once.verdict != Verdict.NOT_FINITE:
        assert again.order == once.order
        later = limit_order(limits, once.state, once.order, measured, cap, once.state.t_ns)
        assert later.order == once.order


@FAST
@given(limits_, st.floats(-1, 1), st.floats(0, 8))
def test_steady_wishes_settle_within_the_lateral_limit(limits, steer, speed):
    state = make_limiter_state(limits, Command(0.0, 0.0), 0)
    for k in range(1, 4000):
        out = limit_order(
            limits, state, Command(steer, speed), state.order.speed, inf, k * 10**7 * 2
        )
        lateral = out.order.speed**2 * tan(abs(out.order.steer)) / limits.wheelbase
        assert lateral <= limits.lateral_accel_max * (1 + 1e-9)
        if out.order == state.order:
            break
        state = out.state
