"""The output limiter at its bounds: dense around each limit, NaN never clipped, fixed ceilings."""

from dataclasses import asdict
from math import atan, inf, isfinite, nan, nextafter, tan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.state import Command
from steerd.controller import limits as lim

# Exactly representable, so that every bound can be met exactly.
LIMITS = lim.Limits(
    wheelbase=0.25, steer_left_max=0.375, steer_right_max=0.25, steer_rate_max=2.0, speed_max=3.0,
    accel_max=2.0, decel_max=4.0, lateral_accel_max=3.0, step_max=0.015625,
)  # fmt: skip
STEP_NS = 15_625_000  # the longest step, 1/64 s
STEER_STEP, ACCEL_STEP, DECEL_STEP = 0.03125, 0.03125, 0.0625
EPS = 1e-12


def near(bound):
    return [bound + k * EPS for k in (-1000, -3, -1, 0, 1, 3, 1000)]


def pass_gate(steer, speed, last=(0.0, 0.0), v=0.0, cap=inf, dt_ns=STEP_NS):
    state = lim.make_limiter_state(LIMITS, Command(*last), 0)
    return lim.limit_order(LIMITS, state, Command(steer, speed), v, cap, dt_ns)


GRIP_STEER, GRIP_SPEED = atan(3.0 * 0.25 / 4.0), (3.0 * 0.25 / tan(0.25)) ** 0.5
"""What the lateral limit leaves at a real 2 m/s, and to a car that is told to steer 0.25 rad."""


@pytest.mark.parametrize(("axis", "bound", "side", "last", "more"), [
    ("steer", 0.375, 1, (0.375, 0.0), {}), ("steer", -0.25, -1, (-0.25, 0.0), {}),
    ("steer", STEER_STEP, 1, (0.0, 0.0), {}), ("steer", -STEER_STEP, -1, (0.0, 0.0), {}),
    ("speed", 1.0 + ACCEL_STEP, 1, (0.0, 1.0), {}), ("speed", 1.0 - DECEL_STEP, -1, (0.0, 1.0), {}),
    ("speed", 3.0, 1, (0.0, 3.0), {}), ("speed", 0.0, -1, (0.0, 0.0), {}),
    ("speed", 0.5, 1, (0.0, 0.5), {"cap": 0.5}),
    ("steer", GRIP_STEER, 1, (GRIP_STEER, 0.0), {"v": 2.0}),
    ("steer", -GRIP_STEER, -1, (-GRIP_STEER, 0.0), {"v": 2.0}),
    ("speed", GRIP_SPEED, 1, (0.25, GRIP_SPEED), {"steer": 0.25}),
], ids=["left", "right is its own", "rate to the left", "rate to the right", "acceleration",
        "deceleration has its own", "top speed", "no reverse", "the supervisor's cap",
        "grip to the left", "grip to the right", "grip of the ordered angle"])  # fmt: skip
def test_an_order_is_held_at_each_bound_and_passes_before_it(axis, bound, side, last, more):
    """`side` is 1 where the bound is the most, -1 where it is the least."""
    for wish in near(bound):
        out = pass_gate(**{"steer": 0.0, "speed": 0.0, axis: wish, **more}, last=last)
        over = side * (wish - bound) > 0.0
        assert getattr(out.order, axis) == (bound if over else wish)
        assert out.verdict == (lim.Verdict.CLIPPED if over else lim.Verdict.PASSED)
        assert (out.state.order, out.state.t_ns) == (out.order, STEP_NS)


def test_a_cap_is_reached_at_the_deceleration_limit_may_be_zero_and_must_be_a_speed():
    assert pass_gate(0.0, 2.0, last=(0.0, 2.0), cap=0.0).order.speed == 2.0 - DECEL_STEP
    assert pass_gate(0.0, 0.0, cap=0.0).verdict == lim.Verdict.PASSED
    for cap in (nan, -1e-300, -inf):
        assert pass_gate(0.0, 0.0, cap=cap).verdict == lim.Verdict.NOT_FINITE


def test_rolling_backwards_takes_grip_and_where_that_falls_too_fast_the_speed_gives():
    assert pass_gate(0.25, 0.0, last=(0.25, 0.0), v=-2.0).order.steer < 0.25
    out = pass_gate(0.375, 3.0, last=(0.375, 3.0), v=3.0)
    assert (out.order.steer, out.order.speed) == (0.375 - STEER_STEP, 3.0 - DECEL_STEP)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("place", ["steer", "speed", "v"])
def test_not_finite_is_a_verdict_and_never_clipped(bad, place):
    given = {"steer": 0.25, "speed": 0.25, "v": 0.25, place: bad}
    out = pass_gate(**given, last=(0.125, 1.0))
    assert out.verdict is lim.Verdict.NOT_FINITE
    assert (out.order, out.state.t_ns) == (Command(0.125, 1.0), 0)


@pytest.mark.parametrize(("dt_ns", "steer", "speed"), [
    (5_000_000, 2.0 * 0.005, 2.0 * 0.005), (3_600 * 10**9, STEER_STEP, ACCEL_STEP),
])  # fmt: skip
def test_rates_are_per_second_and_a_pause_does_not_allow_a_jump(dt_ns, steer, speed):
    out = pass_gate(0.25, 3.0, dt_ns=dt_ns)
    assert out.order == Command(pytest.approx(steer), pytest.approx(speed))


def test_time_running_backwards_allows_nothing():
    state = lim.make_limiter_state(LIMITS, Command(0.0, 1.0), 10**9)
    out = lim.limit_order(LIMITS, state, Command(0.25, 3.0), 0.0, inf, 0)
    assert (out.order, out.state.t_ns) == (Command(0.0, 1.0), 10**9)


def test_steer_bound_closes_with_speed_and_speed_bound_with_steering():
    assert lim.steer_bound(LIMITS, 0.0) > 1.5
    assert lim.steer_bound(LIMITS, 0.5) == atan(0.75 / 0.25), "at walking pace"
    assert (lim.steer_bound(LIMITS, 2.0), lim.steer_bound(LIMITS, 1e200)) == (atan(0.75 / 4.0), 0.0)
    assert 4.0 * tan(lim.steer_bound(LIMITS, 2.0)) / 0.25 <= 3.0 * (1 + 1e-15)
    assert lim.speed_bound(LIMITS, 0.0) == 3.0
    assert lim.speed_bound(LIMITS, -0.375) == (0.75 / tan(0.375)) ** 0.5


def test_start_state_is_brought_inside_the_limits():
    assert lim.make_limiter_state(LIMITS, Command(9.0, 9.0), 7).order == Command(0.375, 3.0)
    assert lim.make_limiter_state(LIMITS, Command(-9.0, -9.0), 7).order == Command(-0.25, 0.0)
    assert lim.make_limiter_state(LIMITS, Command(0.1, 0.2), 7).t_ns == 7
    for order in (Command(nan, 0.0), Command(0.0, inf)):
        with pytest.raises(ValueError, match="cannot start"):
            lim.make_limiter_state(LIMITS, order, 0)


@pytest.mark.parametrize("name", lim.CEILINGS)
def test_every_ceiling_holds_exactly(name):
    values = asdict(lim.Limits(wheelbase=0.33))
    bound = lim.CEILINGS[name]
    for value in (bound.low, bound.high):
        assert getattr(lim.Limits(**{**values, name: value}), name) == value
    for value in (nextafter(bound.low, -inf), nextafter(bound.high, inf), nan, inf):
        with pytest.raises(lim.LimitError, match=f"^{name} = "):
            lim.Limits(**{**values, name: value})


def test_every_field_has_a_ceiling_and_the_message_says_which():
    assert set(asdict(lim.Limits(wheelbase=0.33))) == set(lim.CEILINGS)
    with pytest.raises(lim.LimitError) as caught:
        lim.Limits(wheelbase=0.33, steer_rate_max=3.3, lateral_accel_max=3.5)
    first, second = str(caught.value).splitlines()
    assert first.startswith("steer_rate_max = 3.3 rad/s is outside 0.1..3.2 rad/s")
    assert second.startswith("lateral_accel_max = 3.5 m/s2")


def test_ceilings_are_these_and_changing_one_is_a_decision():
    assert {name: bound[:2] for name, bound in lim.CEILINGS.items()} == {
        "wheelbase": (0.05, 1.0), "steer_left_max": (0.01, 0.6), "steer_right_max": (0.01, 0.6),
        "steer_rate_max": (0.1, 3.2), "speed_max": (0.1, 6.0), "accel_max": (0.1, 2.5),
        "decel_max": (1.5, 6.0), "lateral_accel_max": (0.1, 3.0), "step_max": (0.001, 0.025),
    }  # fmt: skip


# What it promises for any sequence of orders.
FAST = settings(derandomize=True, deadline=None, max_examples=300)
limits_ = st.builds(
    lim.Limits, wheelbase=st.floats(0.1, 0.6), steer_left_max=st.floats(0.05, 0.6),
    steer_right_max=st.floats(0.05, 0.6), steer_rate_max=st.floats(0.1, 3.2),
    speed_max=st.floats(0.1, 6.0), accel_max=st.floats(0.1, 2.5), decel_max=st.floats(1.5, 6.0),
    lateral_accel_max=st.floats(0.1, 3.0),
)  # fmt: skip
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
    state, t_ns = lim.make_limiter_state(limits, Command(0.0, 0.0), 0), 0
    for steer, speed, measured, cap, step_ns in sequence:
        t_ns += step_ns
        dt = min(max((t_ns - state.t_ns) * 1e-9, 0.0), limits.step_max)
        out = lim.limit_order(limits, state, Command(steer, speed), measured, cap, t_ns)
        finite = isfinite(steer) and isfinite(speed) and isfinite(measured)
        assert (out.verdict == lim.Verdict.NOT_FINITE) == (not finite)
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
    state = lim.make_limiter_state(limits, Command(last_steer, last_speed), 0)
    once = lim.limit_order(limits, state, Command(steer, speed), measured, cap, step_ns)
    seen = measured if isfinite(measured) else 0.0
    again = lim.limit_order(limits, state, once.order, seen, cap, step_ns)
    if once.verdict != lim.Verdict.NOT_FINITE:
        assert again.order == once.order
        later = lim.limit_order(limits, once.state, once.order, measured, cap, once.state.t_ns)
        assert later.order == once.order


@FAST
@given(limits_, st.floats(-1, 1), st.floats(0, 8))
def test_steady_wishes_settle_within_the_lateral_limit(limits, steer, speed):
    state = lim.make_limiter_state(limits, Command(0.0, 0.0), 0)
    for k in range(1, 4000):
        wish, t_ns = Command(steer, speed), k * 10**7 * 2
        out = lim.limit_order(limits, state, wish, state.order.speed, inf, t_ns)
        lateral = out.order.speed**2 * tan(abs(out.order.steer)) / limits.wheelbase
        assert lateral <= limits.lateral_accel_max * (1 + 1e-9)
        if out.order == state.order:
            break
        state = out.state
