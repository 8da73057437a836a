"""The compiled filter gives what the reference gives, whose algebra is filterpy's."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import Chassis
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR, Car
from steerd.car_model.planar import CHASSIS
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command
from steerd.estimator.config import FilterConfig
from steerd.estimator.health import NO_TALLY
from steerd.estimator.history import History
from steerd.estimator.initial import make_belief
from steerd.estimator.sensors import make_gyro, make_pose, make_wheel_speed
from steerd.estimator.state_filter import (
    FilterState,
    Node,
    StateFilter,
    make_state_filter,
    predict_to,
    step,
)

MS = 1_000_000
T0 = 10**12
ODD_CAR = PAPER_CAR._replace(
    speed_gain=1.07, steer_gain=0.9, steer_bias=0.02, steer_delay=0.012, drive_delay=0.004,
    pose_delay=0.003,
)  # fmt: skip


def both(
    car: Car[float], chassis: Chassis = SINGLE_TRACK, config: FilterConfig | None = None
) -> tuple[StateFilter, ...]:
    """The reference and the compiled filter of a car."""
    return tuple(
        make_state_filter(car, config, chassis=chassis, reference=reference)
        for reference in (True, False)
    )


def assert_close(found: Any, expected: Any) -> None:
    """But for the last places, by the largest number beside it."""
    size = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * size)


def assert_same(one: FilterState, other: FilterState) -> None:
    """The same nodes."""
    assert len(one.nodes) == len(other.nodes)
    for a, b in zip(one.nodes, other.nodes, strict=True):
        assert_close(b.belief.mean, a.belief.mean)
        assert_close(b.belief.covariance, a.belief.covariance)
        np.testing.assert_allclose(b.nis, a.nis, rtol=1e-6, atol=1e-9)
        assert (a.measurement, a.believed) == (b.measurement, b.believed)


@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
@pytest.mark.parametrize("car", [DEFAULT_CAR, ODD_CAR])
def test_a_drive_gives_the_same(simulate, run_filter, car, chassis):
    drive = simulate(seed=3, seconds=1.0, car=car, gyro=True)
    reference, compiled = both(car, chassis)
    pairs = zip(run_filter(reference, drive), run_filter(compiled, drive), strict=True)
    for k, ((t_ns, one), (_, other)) in enumerate(pairs):
        if k % 40 == 0:
            assert_same(one, other)
            seen = [predict_to(flt, s, t_ns) for flt, s in ((reference, one), (compiled, other))]
            if seen[0] is not None:
                assert_close(seen[1].state, seen[0].state)
                assert_close(seen[1].sd, seen[0].sd)


FINITE = st.floats(-1.0, 1.0)


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Node, History, list[Any]]:
    """A belief somewhere, orders about it, and what is measured after it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([3.0, 3.0, 3.0, 1.0, 2.0, 0.3, 0.3])
    mean = scale * rng.uniform(-1.0, 1.0, 7) + np.array([0, 0, 0, draw(st.floats(-1, 3)), 0, 0, 0])
    root = 10.0 ** draw(st.floats(-4.0, 0.0)) * rng.standard_normal((7, 7))
    belief = make_belief(mean, root @ root.T + 1e-10 * np.eye(7))
    times = tuple(T0 - 60 * MS + k * draw(st.integers(1, 12)) * MS for k in range(12))
    times = tuple(sorted(set(times)))
    orders = tuple(
        None if rng.random() < 0.2 else Command(*rng.uniform((-0.5, -1.0), (0.5, 4.0)).tolist())
        for _ in times
    )
    measured = [make_wheel_speed(T0 + 3 * MS, mean[3] + draw(FINITE))]
    measured += [make_gyro(T0 + draw(st.integers(0, 40)) * MS, mean[4] + draw(FINITE))]
    place = draw(st.integers(0, 400)) * MS
    pose = (float(value) + 0.1 * draw(FINITE) for value in mean[:3])
    measured += [make_pose(T0 + place, *pose)]
    first = make_pose(T0, *mean[:3].tolist())
    return (Node(first, belief, math.nan, True, NO_TALLY), History(times, orders), measured)


@settings(max_examples=60)
@given(
    scene=scenes(), car=st.sampled_from([DEFAULT_CAR, ODD_CAR]), chassis=st.sampled_from(CHASSIS)
)
def test_any_belief_orders_and_measurements_give_the_same(scene, car, chassis):
    node, history, measured = scene
    end = T0 + 450 * MS
    states = []
    for flt in both(car, chassis):
        state = step(flt, FilterState((node,), history), end, measured)
        states.append((state, predict_to(flt, state, end)))
    (one, look), (other, compiled_look) = states
    assume(look.belief.covariance.max() < 1e4)  # 100 m: beyond, the last places grow without end
    assert_same(one, other)
    assert_close(compiled_look.belief.covariance, look.belief.covariance)
    assert_close(compiled_look.health.position_sd, look.health.position_sd)


def test_readings_that_are_no_numbers_are_not_believed():
    flts = both(DEFAULT_CAR)
    start = make_belief(np.zeros(7), np.eye(7))
    node = Node(make_pose(T0, 0, 0, 0), start, math.nan, True, NO_TALLY)
    bad = [make_wheel_speed(T0 + MS, math.nan), make_pose(T0 + 2 * MS, 1e9, 0.0, 0.0)]
    one, other = (step(flt, FilterState((node,)), T0 + 5 * MS, bad) for flt in flts)
    assert_same(one, other)
    assert not other.nodes[-1].believed


def test_a_belief_that_is_not_finite_is_not_sound_and_believes_nothing():
    kernel = both(DEFAULT_CAR)[1].kernel
    huge = make_belief(np.full(7, 1e300), 1e300 * np.eye(7))
    assert not kernel.predict(History(), huge, T0, T0 + 5 * MS).sound
    (link,) = kernel.fuse(History(), huge, T0, [make_gyro(T0 + MS, 0.0)])
    assert not link.believed
    assert not math.isfinite(link.nis)


def test_a_long_chain_is_followed_to_its_end():
    kernel = both(DEFAULT_CAR)[1].kernel
    chain = [make_gyro(T0 + k * MS, 0.0) for k in range(400)]
    found = kernel.fuse(History(), make_belief(np.zeros(7), np.eye(7)), T0, chain)
    assert len(found) == 400
    assert found[-1].believed
