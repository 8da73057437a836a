"""Symmetries and exactness of the equations, over random cars and states."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import SPEED_DYNAMIC, SPEED_KINEMATIC, Chassis, derivative
from steerd.car_model.linear import rates_and_jacobian
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, GRAVITY, PARAMETERS, Car
from steerd.car_model.planar import CHASSIS
from steerd.car_model.rollout import simulate, start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command, State

repeatable = settings(derandomize=True, deadline=None, max_examples=60)


def about(value: float, share: float = 0.3) -> st.SearchStrategy[float]:
    return st.floats(1.0 - share, 1.0 + share).map(lambda ratio: value * ratio)


cars = st.builds(
    Car,
    *(
        about(p.default) if p.default else st.floats(max(p.low, -0.02), min(p.high, 0.02))
        for p in PARAMETERS
    ),
)
states = st.builds(
    State,
    st.floats(-5, 5),
    st.floats(-5, 5),
    st.floats(-4, 4),
    st.floats(-0.5, 5.0),
    st.floats(-4, 4),
    st.floats(-0.4, 0.4),
    st.floats(-0.34, 0.34),
)
wheels = st.floats(-0.4, 0.4)
accels = st.floats(-5.0, 5.0)
drives = st.lists(
    st.builds(Command, st.floats(-0.5, 0.5), st.floats(-0.5, 4.0)), min_size=5, max_size=25
)
STEP = 0.005


def run(
    car: Car[float],
    first: State[float],
    drive: list[Command[float]],
    chassis: Chassis = SINGLE_TRACK,
) -> list[State[float]]:
    model = Model(car, chassis=chassis)
    return [m.state for m in simulate(FLOAT, model, start(model, first, 0.0), drive, STEP)]


def near_a_seam(speed: float) -> bool:
    """Whether a small step in speed crosses a change of formula."""
    return any(abs(speed - seam) < 1e-4 for seam in (SPEED_KINEMATIC, SPEED_DYNAMIC))


@repeatable
@given(cars, states, wheels, accels)
def test_generated_rates_are_the_equations(car, state, wheel, accel):
    rates, _ = rates_and_jacobian(car, state, wheel, accel)
    expected = derivative(SINGLE_TRACK, FLOAT, car, state, wheel, accel)
    assert rates == pytest.approx(tuple(expected), rel=1e-11, abs=1e-11)


@repeatable
@given(cars, states, wheels, accels)
def test_generated_jacobian_is_that_of_central_differences(car, state, wheel, accel):
    if near_a_seam(state.speed):
        state = state._replace(speed=state.speed + 1e-3)
    jacobian = rates_and_jacobian(car, state, wheel, accel)[1]
    point = (*state[:6], wheel, accel)
    width = 1e-6
    for column in range(8):
        ends = []
        for side in (width, -width):
            moved = [v + side * (i == column) for i, v in enumerate(point)]
            at = State(*moved[:6], state.steer)
            ends.append(derivative(SINGLE_TRACK, FLOAT, car, at, moved[6], moved[7]))
        slopes = [(a - b) / (2.0 * width) for a, b in zip(*ends, strict=True)]
        found = [row[column] for row in jacobian]
        scale = 1.0 + max(map(abs, slopes))
        assert found == pytest.approx(slopes, abs=2e-7 * scale)


@repeatable
@given(cars, states, wheels, accels)
def test_above_walking_pace_it_is_commonroads_single_track_model(car, state, wheel, accel):
    """CommonRoad vehicle models, section ST, written out longhand."""
    state = state._replace(speed=SPEED_DYNAMIC + abs(state.speed))
    mu, m, inertia, h = car.mu, car.mass, car.inertia_z, car.cog_height
    lf, lr, c_f, c_r, g = car.lf, car.lr, car.c_sf, car.c_sr, GRAVITY
    v, r, beta = state.speed, state.yaw_rate, state.slip_angle
    front, rear = g * lr - accel * h, g * lf + accel * h
    r_dot = (
        -(mu * m / (v * inertia * (lr + lf))) * (lf**2 * c_f * front + lr**2 * c_r * rear) * r
        + (mu * m / (inertia * (lr + lf))) * (lr * c_r * rear - lf * c_f * front) * beta
        + (mu * m / (inertia * (lr + lf))) * lf * c_f * front * wheel
    )
    beta_dot = (
        ((mu / (v**2 * (lr + lf))) * (c_r * rear * lr - c_f * front * lf) - 1.0) * r
        - (mu / (v * (lr + lf))) * (c_r * rear + c_f * front) * beta
        + (mu / (v * (lr + lf))) * c_f * front * wheel
    )
    rates = derivative(SINGLE_TRACK, FLOAT, car, state, wheel, accel)
    size = 1.0 + abs(r) * 100.0 / v + 300.0 * (abs(beta) + abs(wheel))
    assert rates.yaw_rate == pytest.approx(r_dot, rel=1e-12, abs=1e-12 * size)
    assert rates.slip_angle == pytest.approx(beta_dot, rel=1e-12, abs=1e-12 * size)
    assert rates.x == v * math.cos(state.yaw + beta)
    assert rates.y == v * math.sin(state.yaw + beta)
    assert (rates.yaw, rates.speed) == (r, accel)


every_chassis = pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)


@every_chassis
@repeatable
@given(first=states, drive=drives)
def test_left_and_right_are_mirror_images(chassis, first, drive):
    def mirrored(s: State[float]) -> State[float]:
        return State(s.x, -s.y, -s.yaw, s.speed, -s.yaw_rate, -s.slip_angle, -s.steer)

    there = run(DEFAULT_CAR, first, drive, chassis)
    turned = [c._replace(steer=-c.steer) for c in drive]
    assert list(map(mirrored, run(DEFAULT_CAR, mirrored(first), turned, chassis))) == there


@every_chassis
@repeatable
@given(
    first=states, drive=drives, turn=st.floats(-3, 3), dx=st.floats(-10, 10), dy=st.floats(-10, 10)
)
def test_the_world_has_no_favourite_place_or_direction(chassis, first, drive, turn, dx, dy):
    def moved(s: State[float]) -> State[float]:
        c, d = math.cos(turn), math.sin(turn)
        return s._replace(x=dx + c * s.x - d * s.y, y=dy + d * s.x + c * s.y, yaw=s.yaw + turn)

    there = run(DEFAULT_CAR, first, drive, chassis)
    elsewhere = run(DEFAULT_CAR, moved(first), drive, chassis)
    for a, b in zip(there, elsewhere, strict=True):
        assert tuple(moved(a)) == pytest.approx(tuple(b), abs=1e-9)


@repeatable
@given(states, drives, st.integers(1, 4))
def test_a_run_may_be_cut_anywhere(first, drive, cut):
    car = DEFAULT_CAR._replace(steer_delay=0.0)
    whole = run(car, first, drive)
    assert run(car, whole[cut], drive[cut:]) == whole[cut:]
