"""The planar chassis: exact geometry, symmetry, momentum, and the single-track car in the small."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.car_model.chassis import Axles, derivative
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, GRAVITY
from steerd.car_model.planar import DRIVES, body_acceleration, find_chassis, make_planar
from steerd.car_model.rollout import simulate, start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command, State

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


def mirrored(state: State[float]) -> State[float]:
    """The same car seen in a mirror along the world's x axis."""
    return State(
        state.x, -state.y, -state.yaw, state.speed, -state.yaw_rate, -state.slip_angle, -state.steer
    )


@pytest.mark.parametrize("chassis", EVERY, ids=lambda c: c.label)
@given(state=states, accel=st.floats(-6, 6))
def test_left_and_right_are_mirror_images(chassis, state, accel) -> None:
    here = derivative(chassis, FLOAT, CAR, state, state.steer, accel)
    there = derivative(chassis, FLOAT, CAR, mirrored(state), -state.steer, accel)
    signs = (1, -1, -1, 1, -1, -1)
    assert there == pytest.approx([s * r for s, r in zip(signs, here, strict=True)], abs=1e-9)


@pytest.mark.parametrize("chassis", EVERY, ids=lambda c: c.label)
@given(state=states, turn=st.floats(-3, 3))
def test_no_direction_of_the_world_is_special(chassis, state, turn) -> None:
    here = derivative(chassis, FLOAT, CAR, state, state.steer, 0.5)
    turned = derivative(chassis, FLOAT, CAR, state._replace(yaw=state.yaw + turn), state.steer, 0.5)
    c, s = math.cos(turn), math.sin(turn)
    assert turned.x == pytest.approx(c * here.x - s * here.y, abs=1e-9)
    assert turned.y == pytest.approx(s * here.x + c * here.y, abs=1e-9)
    assert turned[2:] == pytest.approx(here[2:], abs=1e-12)


@pytest.mark.parametrize("chassis", EVERY, ids=lambda c: c.label)
@given(
    speed=st.floats(0.6, 4.0),
    slip=st.floats(-1e-3, 1e-3),
    rate=st.floats(-1e-2, 1e-2),
    wheel=st.floats(-1e-3, 1e-3),
)
def test_small_angles_are_the_single_track_car(chassis, speed, slip, rate, wheel) -> None:
    state = ORIGIN._replace(speed=speed, slip_angle=slip, yaw_rate=rate)
    here = derivative(chassis, FLOAT, STIFF, state, wheel, 0.0)
    there = derivative(SINGLE_TRACK, FLOAT, STIFF, state, wheel, 0.0)
    assert here == pytest.approx(there, rel=2e-4, abs=2e-5)


@pytest.mark.parametrize("speed", [0.0, 0.05, 0.2])
def test_a_crawling_car_follows_its_wheels(speed: float) -> None:
    """At rest of yaw rate and slip on the kinematic values nothing changes them."""
    wheel, base = 0.3, CAR.lf + CAR.lr
    state = ORIGIN._replace(
        speed=speed,
        yaw_rate=speed * math.tan(wheel) / base,
        slip_angle=math.atan(CAR.lr * math.tan(wheel) / base),
    )
    rates = derivative(make_planar("rear"), FLOAT, STIFF, state, wheel, 0.0)
    assert rates.yaw_rate == pytest.approx(0.0, abs=0.05)
    assert rates.slip_angle == pytest.approx(0.0, abs=1e-9)


@given(state=states, accel=st.floats(-4, 4), wheel=st.floats(-0.4, 0.4))
def test_forces_and_accelerations_balance(state, accel, wheel) -> None:
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
def test_driven_wheels_turn_faster_than_the_ground_passes(drive: str) -> None:
    """In a straight line slip is the drive force over mu C_x times the driven load."""
    accel, chassis = 3.0, make_planar(drive)
    state = ORIGIN._replace(speed=2.0)
    loads = chassis.axle_loads(FLOAT, CAR, state, accel)
    driven = {"rear": loads.rear, "front": loads.front, "all": loads.rear + loads.front}[drive]
    rates = derivative(chassis, FLOAT, CAR, state, 0.0, accel)
    kappa = CAR.mass * accel / (CAR.mu * CAR.c_x * driven)
    assert rates.x == pytest.approx(2.0 * (1.0 - kappa), rel=1e-12)


def test_cornering_drag_slows_the_body_not_the_wheels() -> None:
    """At a held wheel speed a turn costs ground speed, through the front force's drag alone."""
    model = Model(CAR, chassis=make_planar("rear"))
    first = start(model, ORIGIN._replace(speed=2.0), 0.0)
    run = simulate(FLOAT, model, first, [Command(0.25, 2.0)] * 600, 0.005)
    last, before = run[-1].state, run[-2].state
    travel = math.hypot(last.x - before.x, last.y - before.y) / 0.005
    assert last.speed == pytest.approx(2.0, abs=1e-6)
    assert travel * math.cos(last.slip_angle) < 2.0
    side = travel * last.yaw_rate
    radius = travel / last.yaw_rate
    assert side == pytest.approx(travel**2 / radius, rel=1e-6)
    assert 0.0 < 1.0 - travel * math.cos(last.slip_angle) / 2.0 < 0.05
    assert side < CAR.mu * GRAVITY


def test_paths_converge_with_the_step() -> None:
    """RK4 at 5 ms against 0.5 ms over two seconds of slalom: under a tenth of a millimetre."""
    ends = []
    for h in (0.005, 0.0005):
        model = Model(CAR, chassis=make_planar("all"))
        count = round(2.0 / h)
        commands = [Command(0.2 * math.sin(4.0 * k * h), 2.0) for k in range(count)]
        held = [commands[k - k % round(0.005 / h)] for k in range(count)]
        run = simulate(FLOAT, model, start(model, ORIGIN._replace(speed=2.0), 0.0), held, h)
        ends.append(np.array(run[-1].state[:2]))
    assert np.linalg.norm(ends[0] - ends[1]) < 1e-4


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="no chassis"):
        find_chassis("bicycle", "rear")
    with pytest.raises(ValueError, match="drive is"):
        make_planar("left")
