"""The planar chassis: exact geometry, symmetry, momentum, and the single-track car in the small."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.car_model.chassis import Axles, derivative
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.planar import DRIVES, body_acceleration, find_chassis, make_planar
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, State

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
