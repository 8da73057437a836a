"""What the output limiter promises for any sequence of orders."""

from math import inf, isfinite, tan

from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.state import Command
from steerd.controller.limits import Limits, Verdict, limit_order, make_limiter_state

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
