"""The filter's motion and its estimates against plainer ones that share only the plant."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import Chassis
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR, Car
from steerd.car_model.planar import CHASSIS
from steerd.car_model.prediction import ActuatorMotion, slip_density
from steerd.car_model.rollout import start
from steerd.car_model.rollout import step as plant_step
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command, State
from steerd.estimator import state_filter as sf
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import NO_HISTORY, History, add_command
from steerd.estimator.initial import make_belief
from steerd.estimator.reference import Reference
from steerd.estimator.sensors import Kind, make_gyro, make_pose, make_wheel_speed
from tests.textbook import noise_densities, rates_and_slopes

CAR = DEFAULT_CAR
CONFIG = FilterConfig(gate_probability=1.0 - 1e-9)
MS = 1_000_000
ROWS = {Kind.POSE: [0, 1, 2], Kind.WHEEL_SPEED: [3], Kind.GYRO: [4]}
SDS = {Kind.WHEEL_SPEED: [CONFIG.wheel_speed_sd], Kind.GYRO: [CONFIG.gyro_sd]}
SDS[Kind.POSE] = [CONFIG.pose_position_sd, CONFIG.pose_position_sd, CONFIG.pose_yaw_sd]


def textbook_motion(x: np.ndarray, command: Command[float]) -> np.ndarray:
    moment = start(Model(CAR), State(*x.tolist()), 0.0)
    return np.array(plant_step(FLOAT, Model(CAR), moment, command, 0.0, 0.001).state)


def textbook_predict(x: np.ndarray, P: np.ndarray, command: Command[float]):
    ends = [[textbook_motion(x + s * u, command) for u in np.eye(7)] for s in (1e-6, -1e-6)]
    F = (np.array(ends[0]) - ends[1]).T / 2e-6
    Q = 0.001 * np.diag(np.square(noise_densities(CONFIG, x[3])))
    return textbook_motion(x, command), F @ P @ F.T + 0.5 * (F @ Q @ F.T + Q)


def textbook_update(x: np.ndarray, P: np.ndarray, kind: Kind, z: tuple[float, ...]):
    H = np.eye(7)[ROWS[kind]]
    R = np.diag(np.square(SDS[kind]))
    y = np.array(z) - H @ x
    if kind is Kind.POSE:
        y[2] = (y[2] + math.pi) % (2.0 * math.pi) - math.pi
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return x + K @ y, (np.eye(7) - K @ H) @ P


@pytest.mark.parametrize("seed", [21, 22])
def test_same_estimate_as_the_textbook(simulate, run_filter, seed):
    drive = simulate(seed, 1.0, config=CONFIG, gyro=True)
    flt = sf.make_state_filter(CAR, CONFIG)
    runs = list(run_filter(flt, drive))
    begin = next(state for _, state in runs if state.nodes).nodes[0]
    events = sorted(m for _, m in drive.arrivals if m > begin.measurement)
    x, P, end_ns = begin.belief.mean, begin.belief.covariance, runs[-1][0]
    delay, commands = round(CAR.steer_delay * 1e9), dict(drive.commands)
    first = drive.commands[0][0]

    def sent(t_ns: int) -> Command[float]:
        return commands[max(t_ns - (t_ns - first) % (5 * MS), first)]

    for t in range(begin.measurement.t_ns, end_ns + 1, MS):
        while events and events[0].t_ns <= t:
            x, P = textbook_update(x, P, events[0].kind, events[0].values)
            events.pop(0)
        if t < end_ns:
            x, P = textbook_predict(x, P, Command(sent(t - delay).steer, sent(t).speed))
    rest = [m for arrival, m in drive.arrivals if arrival > end_ns]  # was still under way
    final = sf.predict_to(flt, sf.step(flt, runs[-1][1], end_ns, rest), end_ns)
    np.testing.assert_allclose(final.sd, np.sqrt(np.diag(P)), rtol=0.02)
    assert (np.abs(np.array(final.state) - x) < 0.05 * np.array(final.sd)).all()


# The motion between measurements: the implicit midpoint, its derivatives, its noise.
STATES = [
    State(1.0, -2.0, 0.7, 2.0, 1.1, -0.04, 0.12), State(0.0, 0.0, -3.0, 0.35, -0.3, 0.05, -0.2),
    State(0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.1), State(5.0, 1.0, 9.0, 4.5, -2.0, 0.02, -0.05),
    State(0.0, 0.0, 0.3, -0.6, 0.2, 0.01, 0.2),
]  # fmt: skip


def make_reference(chassis: Chassis) -> Reference:
    return Reference(CAR, chassis, FilterConfig(), {})


every_chassis = pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)


@every_chassis
@pytest.mark.parametrize("state", STATES)
def test_step_is_the_implicit_midpoint_of_the_whole_jacobian(chassis, state):
    driven = ActuatorMotion(0.13, 0.11, 0.7, 0.9, 0.95, -8.0)
    h = 0.008
    rates, J = rates_and_slopes(chassis, CAR, state, driven.wheel, driven.accel)
    W = np.linalg.inv(np.eye(6) - 0.5 * h * J[:, :6])
    F = np.zeros((7, 7))
    F[:6, :6] = W @ (np.eye(6) + 0.5 * h * J[:, :6])
    F[:6, 3] += h * W @ J[:, 7] * driven.accel_by_speed
    F[:6, 6] = h * W @ J[:, 6] * driven.wheel_by_steer
    F[6, 6] = driven.steer_by_steer
    mean, transition, _ = make_reference(chassis).propagate(state, driven, [0.0] * 7, h)
    np.testing.assert_allclose(transition, F, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(mean[:6], np.array(state[:6]) + h * W @ rates, rtol=1e-12)
    assert mean[6] == driven.steer


@every_chassis
@pytest.mark.parametrize("speed", [0.05, 0.25, 0.4, 0.55])
def test_long_steps_at_low_speed_stay_bounded(chassis, speed):
    """A gap of seconds takes steps far beyond the stability limit of an explicit method."""
    belief = make_belief(np.array([0, 0, 0, speed, 2.0, 0.3, 0.1]), np.eye(7) * 1e-2)
    history = add_command(NO_HISTORY, 0, Command(0.1, speed))
    now = make_reference(chassis).predict(history, belief, 20_000_000, 2_520_000_000)
    assert now.sound
    assert np.isfinite(now.belief.covariance).all()
    assert np.linalg.eigvalsh(now.belief.covariance).min() > 0.0
    assert (np.abs(now.belief.mean[4:6]) < [0.5, 0.3]).all()


@pytest.mark.parametrize("state", STATES)
def test_noise_enters_evenly_along_the_step(state):
    """`Q` is the integral of noise carried on by an `F` that grows linearly, summed in pieces."""
    density = list(FilterConfig().noise_density)
    h, pieces = 0.008, 2000
    driven = ActuatorMotion(0.13, 0.11, 0.7, 0.9, 0.95, -8.0)
    _, F, Q = make_reference(SINGLE_TRACK).propagate(state, driven, density, h)
    density[5] = slip_density(FLOAT, density[5], state.speed)
    total = np.zeros((7, 7))
    for s in (np.arange(pieces) + 0.5) / pieces:
        carried = np.eye(7) + s * (F - np.eye(7))
        total += carried @ np.diag(density) @ carried.T * h / pieces
    np.testing.assert_allclose(Q, total, rtol=1e-5, atol=1e-12)
    assert (Q == Q.T).all()


# The compiled filter gives what the reference gives, whose algebra is filterpy's.
T0 = 10**12
ODD_CAR = PAPER_CAR._replace(
    speed_gain=1.07, steer_gain=0.9, steer_bias=0.02, steer_delay=0.012, drive_delay=0.004,
    pose_delay=0.003,
)  # fmt: skip


def both(car: Car[float], chassis: Chassis = SINGLE_TRACK) -> list[sf.StateFilter]:
    return [sf.make_state_filter(car, chassis=chassis, reference=each) for each in (True, False)]


def assert_close(found: Any, expected: Any) -> None:
    """But for the last places, by the largest number beside it."""
    size = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * size)


def assert_same(one: sf.FilterState, other: sf.FilterState) -> None:
    assert len(one.nodes) == len(other.nodes)
    for a, b in zip(one.nodes, other.nodes, strict=True):
        assert_close(b.belief.mean, a.belief.mean)
        assert_close(b.belief.covariance, a.belief.covariance)
        np.testing.assert_allclose(b.nis, a.nis, rtol=1e-6, atol=1e-9)
        assert (a.measurement, a.believed) == (b.measurement, b.believed)


FINITE = st.floats(-1.0, 1.0)


@st.composite
def scenes(draw: st.DrawFn) -> tuple[sf.Node, History, list[Any]]:
    """A belief somewhere, orders about it, and what is measured after it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([3.0, 3.0, 3.0, 1.0, 2.0, 0.3, 0.3])
    mean = scale * rng.uniform(-1.0, 1.0, 7) + np.array([0, 0, 0, draw(st.floats(-1, 3)), 0, 0, 0])
    root = 10.0 ** draw(st.floats(-4.0, 0.0)) * rng.standard_normal((7, 7))
    belief = make_belief(mean, root @ root.T + 1e-10 * np.eye(7))
    steps = {k * draw(st.integers(1, 12)) for k in range(12)}
    times = tuple(T0 + (step - 60) * MS for step in sorted(steps))
    drawn = rng.uniform((-0.5, -1.0), (0.5, 4.0), (len(times), 2)).tolist()
    orders = tuple(None if rng.random() < 0.2 else Command(*each) for each in drawn)
    pose = [float(value) + 0.1 * draw(FINITE) for value in mean[:3]]
    measured = [
        make_wheel_speed(T0 + 3 * MS, mean[3] + draw(FINITE)),
        make_gyro(T0 + draw(st.integers(0, 40)) * MS, mean[4] + draw(FINITE)),
        make_pose(T0 + draw(st.integers(0, 400)) * MS, *pose),
    ]
    first = make_pose(T0, *mean[:3].tolist())
    return (sf.Node(first, belief, math.nan, True, sf.NO_TALLY), History(times, orders), measured)


CARS = st.sampled_from([DEFAULT_CAR, ODD_CAR])


@settings(max_examples=60)
@given(scene=scenes(), car=CARS, chassis=st.sampled_from(CHASSIS))
def test_any_belief_orders_and_measurements_give_the_same(scene, car, chassis):
    node, history, measured = scene
    end = T0 + 450 * MS
    states = []
    for flt in both(car, chassis):
        state = sf.step(flt, sf.FilterState((node,), history), end, measured)
        states.append((state, sf.predict_to(flt, state, end)))
    (one, look), (other, compiled_look) = states
    moments = [*(node.measurement.t_ns for node in one.nodes[1:]), end]
    for passed, t_ns in zip(one.nodes, moments, strict=True):  # before each measurement
        met = sf.predict_to(flt, sf.FilterState((passed,), history), t_ns)
        assume(met.belief.covariance.max() < 1e2)  # 10 m: beyond, last places grow without end
    assert_same(one, other)
    assert_close(compiled_look.belief.covariance, look.belief.covariance)
    assert_close(compiled_look.health.position_sd, look.health.position_sd)


def test_a_belief_that_is_not_finite_believes_nothing_and_a_long_chain_is_followed_to_its_end():
    kernel = both(DEFAULT_CAR)[1].kernel
    huge = make_belief(np.full(7, 1e300), 1e300 * np.eye(7))
    assert not kernel.predict(History(), huge, T0, T0 + 5 * MS).sound
    (link,) = kernel.fuse(History(), huge, T0, [make_gyro(T0 + MS, 0.0)])
    assert not link.believed
    assert not math.isfinite(link.nis)
    chain = [make_gyro(T0 + k * MS, 0.0) for k in range(400)]
    found = kernel.fuse(History(), make_belief(np.zeros(7), np.eye(7)), T0, chain)
    assert len(found) == 400
    assert found[-1].believed
