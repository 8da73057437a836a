"""The planar chassis, and the linear models of every chassis against textbook formulas."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.car_model.chassis import Axles, derivative
from steerd.car_model.linear import augmented, lane_error_model, rates_and_jacobian, sample
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.planar import CHASSIS, DRIVES, body_acceleration, find_chassis, make_planar
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, State
from tests.textbook import axle_stiffness, rates_and_slopes

CAR = DEFAULT_CAR
STIFF = CAR._replace(c_x=200.0)
EVERY = [make_planar(drive) for drive in DRIVES]

states = st.builds(
    State,
    x=st.floats(-5, 5),
    y=st.floats(-5, 5),
    yaw=st.floats(-4, 4),
    speed=st.floats(0.0, 5.0),
    yaw_rate=st.floats(-4, 4),
    slip_angle=st.floats(-0.3, 0.3),
    steer=st.floats(-0.4, 0.4),
)


@pytest.mark.parametrize("chassis", EVERY, ids=lambda c: c.label)
@given(
    speed=st.floats(0.6, 4.0),
    slip=st.floats(-1e-3, 1e-3),
    rate=st.floats(-1e-2, 1e-2),
    wheel=st.floats(-1e-3, 1e-3),
)
def test_small_angles_are_the_single_track_car(chassis, speed, slip, rate, wheel):
    state = ORIGIN._replace(speed=speed, slip_angle=slip, yaw_rate=rate)
    here = derivative(chassis, FLOAT, STIFF, state, wheel, 0.0)
    there = derivative(SINGLE_TRACK, FLOAT, STIFF, state, wheel, 0.0)
    assert here == pytest.approx(there, rel=2e-4, abs=2e-5)


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


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="no chassis"):
        find_chassis("bicycle", "rear")
    with pytest.raises(ValueError, match="drive is"):
        make_planar("left")


# Linear models against textbook formulas and the nonlinear car.
OVERSTEERING = CAR._replace(c_sf=6.0, c_sr=4.0)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_lane_errors_need_speed(speed):
    with pytest.raises(ValueError, match="positive speed"):
        lane_error_model(CAR, speed)


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


@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
@pytest.mark.parametrize("car", [CAR, OVERSTEERING], ids=["understeers", "oversteers"])
@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5, 1.5, 4.0])
def test_about_straight_driving_every_chassis_has_the_same_linear_model(chassis, car, speed):
    """What a design is made from: what sets the chassis apart is of second order there."""
    straight = ORIGIN._replace(speed=speed)
    found = rates_and_slopes(chassis, car, straight, 0.0, 0.0)[1]
    expected = rates_and_jacobian(car, straight, 0.0, 0.0)[1]
    np.testing.assert_allclose(found[4:, 3:], expected[4:, 3:], rtol=1e-12, atol=1e-12)


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


@pytest.mark.parametrize(("period", "delay"), [(0.0, 0.0), (-1.0, 0.0), (0.01, -0.001)])
def test_sampling_refuses_nonsense(period, delay):
    with pytest.raises(ValueError, match="cannot sample"):
        sample(np.zeros((1, 1)), np.ones((1, 1)), period, delay)
