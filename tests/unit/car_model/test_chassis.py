"""The planar chassis, and the linear models of every chassis against textbook formulas."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import SPEED_DYNAMIC, SPEED_KINEMATIC, Axles, derivative
from steerd.car_model.linear import augmented, lane_error_model, rates_and_jacobian, sample
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, GRAVITY, PARAMETERS, Car
from steerd.car_model.planar import CHASSIS, DRIVES, body_acceleration, make_planar
from steerd.car_model.rollout import simulate, start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command, State
from tests.textbook import axle_stiffness, rates_and_slopes

CAR = DEFAULT_CAR
every_chassis = pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)

states = st.builds(
    State, st.floats(-5, 5), st.floats(-5, 5), st.floats(-4, 4), st.floats(-0.5, 5.0),
    st.floats(-4, 4), st.floats(-0.4, 0.4), st.floats(-0.34, 0.34),
)  # fmt: skip


@given(state=states, accel=st.floats(-4, 4), wheel=st.floats(-0.4, 0.4))
def test_forces_and_accelerations_balance(state, accel, wheel):
    """Newton in the body's frame, from the rates: no force is lost between the axes."""
    state = state._replace(speed=max(state.speed, 0.6))
    chassis = make_planar("rear")
    forces, loads = Axles(7.0, -4.0), chassis.axle_loads(FLOAT, CAR, state, accel)
    rates = chassis.rates(FLOAT, CAR, state, wheel, accel, loads, forces)
    travel = math.hypot(rates.x, rates.y)
    felt = body_acceleration(FLOAT, state, accel)
    # Across the velocity: V (d beta / dt + r) = a_y cos(beta) - a_x sin(beta).
    across = travel * (rates.slip_angle + state.yaw_rate)
    side = (forces.front * math.cos(wheel) + forces.rear) / CAR.mass
    slip = state.slip_angle
    assert across == pytest.approx(side * math.cos(slip) - felt * math.sin(slip), abs=1e-9)
    moment = CAR.lf * forces.front * math.cos(wheel) - CAR.lr * forces.rear
    assert rates.yaw_rate == pytest.approx(moment / CAR.inertia_z, rel=1e-12)
    # Along the body: the driven wheels carry m a_x and the front force's drag.
    drive = CAR.mass * felt + forces.front * math.sin(wheel)
    kappa = drive / (CAR.mu * CAR.c_x * loads.rear)
    assert travel * math.cos(slip) == pytest.approx(state.speed * (1.0 - kappa), rel=1e-9)


@pytest.mark.parametrize("drive", DRIVES)
def test_driven_wheels_turn_faster_than_the_ground_passes(drive):
    """In a straight line slip is the drive force over mu C_x times the driven load."""
    accel, chassis = 3.0, make_planar(drive)
    state = ORIGIN._replace(speed=2.0)
    loads = chassis.axle_loads(FLOAT, CAR, state, accel)
    driven = {"rear": loads.rear, "front": loads.front, "all": loads.rear + loads.front}[drive]
    rates = derivative(chassis, FLOAT, CAR, state, 0.0, accel)
    kappa = CAR.mass * accel / (CAR.mu * CAR.c_x * driven)
    assert rates.x == pytest.approx(2.0 * (1.0 - kappa), rel=1e-12)


def test_nonsense_is_refused():
    for speed in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="positive speed"):
            lane_error_model(CAR, speed)
    for period, delay in ((0.0, 0.0), (-1.0, 0.0), (0.01, -0.001)):
        with pytest.raises(ValueError, match="cannot sample"):
            sample(np.zeros((1, 1)), np.ones((1, 1)), period, delay)


# Linear models against textbook formulas and the nonlinear car.
OVERSTEERING = CAR._replace(c_sf=6.0, c_sr=4.0)


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.5, 5.0])
@pytest.mark.parametrize("car", [CAR, OVERSTEERING], ids=["understeers", "oversteers"])
def test_lane_errors_are_rajamanis_equation_2_45(car, speed):
    """Rajamani's C_af is per tyre and appears as 2 C_af, which is cf per axle here."""
    cf, cr = axle_stiffness(car)
    m, inertia, lf, lr, v = car.mass, car.inertia_z, car.lf, car.lr, speed
    moment, turning = cf * lf - cr * lr, cf * lf**2 + cr * lr**2
    a = [
        [0, 1, 0, 0],
        [0, -(cf + cr) / (m * v), (cf + cr) / m, (-cf * lf + cr * lr) / (m * v)],
        [0, 0, 0, 1],
        [0, -moment / (inertia * v), moment / inertia, -turning / (inertia * v)],
    ]
    b1 = [0, cf / m, 0, cf * lf / inertia]
    b2 = [0, -(cf * lf - cr * lr) / (m * v) - v, 0, -(cf * lf**2 + cr * lr**2) / (inertia * v)]
    found = lane_error_model(car, speed)
    np.testing.assert_allclose(found.a, a, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.b_steer, b1, rtol=1e-10)
    np.testing.assert_allclose(found.b_curvature, np.multiply(b2, v), rtol=1e-10, atol=1e-10)


@every_chassis
@pytest.mark.parametrize("car", [CAR, OVERSTEERING], ids=["understeers", "oversteers"])
@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5, 1.5, 4.0])
def test_about_straight_driving_every_chassis_has_the_same_linear_model(chassis, car, speed):
    """What a design is made from: what sets the chassis apart is of second order there."""
    straight = ORIGIN._replace(speed=speed)
    rates, slopes = rates_and_slopes(chassis, car, straight, 0.0, 0.0)
    wanted, expected = map(np.array, rates_and_jacobian(car, straight, 0.0, 0.0))
    np.testing.assert_allclose(rates, wanted, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(slopes[1:], expected[1:], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(slopes[0, :7], expected[0, :7], rtol=1e-12, atol=1e-12)  # no slip


def test_sampling_a_double_integrator_is_exact():
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    h = 0.1
    plain = sample(a, b, h)
    np.testing.assert_allclose(plain.a, [[1, h], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(plain.b[:, 0], [h * h / 2, h], atol=1e-15)
    np.testing.assert_array_equal(plain.b_late, 0.0)
    late = sample(a, b, h, 0.03)
    np.testing.assert_allclose(late.b[:, 0], [0.07**2 / 2, 0.07], atol=1e-15)
    np.testing.assert_allclose(late.b_late[:, 0], [0.03 * (h - 0.015), 0.03], atol=1e-15)


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.01, 0.013, 0.025, 0.03])
def test_the_augmented_system_is_the_delayed_car(delay):
    period, fine = 0.01, 1000
    errors = lane_error_model(CAR, 1.5)
    a, b = errors.a, errors.b_steer[:, None]
    big_a, big_b = augmented(sample(a, b, period, delay))
    rng = np.random.default_rng(3)
    inputs = rng.normal(size=12)
    wide, state = np.zeros(len(big_a)), np.zeros(4)
    small = sample(a, b, period / fine)
    for k, u in enumerate(inputs):
        wide = big_a @ wide + big_b[:, 0] * u
        for i in range(fine):
            held = math.floor((k * fine + i - round(delay / period * fine)) / fine)
            past = inputs[held] if held >= 0 else 0.0
            state = small.a @ state + small.b[:, 0] * past
    np.testing.assert_allclose(wide[:4], state, rtol=1e-6, atol=1e-12)


# Symmetries of the equations.
repeatable = settings(derandomize=True, deadline=None, max_examples=60)


def about(value: float, share: float = 0.3) -> st.SearchStrategy[float]:
    return st.floats(1.0 - share, 1.0 + share).map(lambda ratio: value * ratio)


small = {p.name: st.floats(max(p.low, -0.02), min(p.high, 0.02)) for p in PARAMETERS}
cars = st.builds(Car, *(about(p.default) if p.default else small[p.name] for p in PARAMETERS))
wheels = st.floats(-0.4, 0.4)
accels = st.floats(-5.0, 5.0)
orders = st.builds(Command, st.floats(-0.5, 0.5), st.floats(-0.5, 4.0))
drives = st.lists(orders, min_size=5, max_size=25)


def run(car, first, drive, chassis=SINGLE_TRACK):
    model = Model(car, chassis=chassis)
    return [m.state for m in simulate(FLOAT, model, start(model, first, 0.0), drive, 0.005)]


@repeatable
@given(cars, states, wheels, accels)
def test_generated_rates_are_the_equations_and_the_jacobian_differences(car, state, wheel, accel):
    rates, _ = rates_and_jacobian(car, state, wheel, accel)
    expected = derivative(SINGLE_TRACK, FLOAT, car, state, wheel, accel)
    assert rates == pytest.approx(tuple(expected), rel=1e-11, abs=1e-11)
    if any(abs(state.speed - seam) < 1e-4 for seam in (SPEED_KINEMATIC, SPEED_DYNAMIC)):
        state = state._replace(speed=state.speed + 1e-3)  # a step crosses a change of formula
    jacobian = np.array(rates_and_jacobian(car, state, wheel, accel)[1])
    point, width = np.array((*state[:6], wheel, accel)), 1e-6

    def moved(step: np.ndarray) -> np.ndarray:
        x = (point + step).tolist()
        at = State(*x[:6], state.steer)
        return np.array(derivative(SINGLE_TRACK, FLOAT, car, at, *x[6:]))

    for column, step in enumerate(width * np.eye(8)):
        slopes = (moved(step) - moved(-step)) / (2.0 * width)
        scale = 1.0 + np.abs(slopes).max()
        assert jacobian[:, column] == pytest.approx(slopes, abs=2e-7 * scale)


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
    assert (rates.x, rates.y) == (v * math.cos(state.yaw + beta), v * math.sin(state.yaw + beta))
    assert (rates.yaw, rates.speed) == (r, accel)


@every_chassis
@repeatable
@given(
    first=states, drive=drives, turn=st.floats(-3, 3), dx=st.floats(-10, 10), dy=st.floats(-10, 10)
)
def test_the_world_has_no_favourite_side_place_or_direction(chassis, first, drive, turn, dx, dy):
    def mirrored(s: State[float]) -> State[float]:
        return State(s.x, -s.y, -s.yaw, s.speed, -s.yaw_rate, -s.slip_angle, -s.steer)

    def moved(s: State[float]) -> State[float]:
        c, d = math.cos(turn), math.sin(turn)
        return s._replace(x=dx + c * s.x - d * s.y, y=dy + d * s.x + c * s.y, yaw=s.yaw + turn)

    there = run(DEFAULT_CAR, first, drive, chassis)
    turned = [c._replace(steer=-c.steer) for c in drive]
    assert list(map(mirrored, run(DEFAULT_CAR, mirrored(first), turned, chassis))) == there
    elsewhere = run(DEFAULT_CAR, moved(first), drive, chassis)
    for a, b in zip(there, elsewhere, strict=True):
        assert tuple(moved(a)) == pytest.approx(tuple(b), abs=1e-9)


@repeatable
@given(states, drives, st.integers(1, 4))
def test_a_run_may_be_cut_anywhere(first, drive, cut):
    car = DEFAULT_CAR._replace(steer_delay=0.0)
    whole = run(car, first, drive)
    assert run(car, whole[cut], drive[cut:]) == whole[cut:]
