import numpy as np
import pytest

from steerd.car_model.chassis import Chassis
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.planar import CHASSIS
from steerd.car_model.prediction import ActuatorMotion, slip_density
from steerd.car_model.rollout import simulate as simulate_car
from steerd.car_model.rollout import start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command, State
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import NO_HISTORY, add_command
from steerd.estimator.initial import make_belief
from steerd.estimator.reference import Reference
from tests.textbook import rates_and_slopes

CAR = DEFAULT_CAR
QUIET = [0.0] * 7
STATES = [
    State(1.0, -2.0, 0.7, 2.0, 1.1, -0.04, 0.12),
    State(0.0, 0.0, -3.0, 0.35, -0.3, 0.05, -0.2),
    State(0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.1),
    State(5.0, 1.0, 9.0, 4.5, -2.0, 0.02, -0.05),
    State(0.0, 0.0, 0.3, -0.6, 0.2, 0.01, 0.2),
]


def make_reference(chassis: Chassis, car=CAR) -> Reference:
    return Reference(car, chassis, FilterConfig(), {})


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
    mean, transition, _ = make_reference(chassis).propagate(state, driven, QUIET, h)
    np.testing.assert_allclose(transition, F, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(mean[:6], np.array(state[:6]) + h * W @ rates, rtol=1e-12)
    assert mean[6] == driven.steer


def plant(
    chassis: Chassis, state: State[float], command: Command[float], seconds: float
) -> np.ndarray:
    """RK4 at 0.1 ms under a constant command."""
    model = Model(CAR._replace(steer_delay=0.0), chassis=chassis)
    count = round(seconds / 1e-4)
    return np.array(
        simulate_car(FLOAT, model, start(model, state, 0.0), [command] * count, 1e-4)[-1].state
    )


@every_chassis
@pytest.mark.parametrize("state", [STATES[0], STATES[3]])
def test_error_falls_with_the_square_of_the_step(chassis, state):
    command = Command(state.steer + 0.1, state.speed + 0.2)  # within the slew limits
    car = CAR._replace(steer_delay=0.0)
    history = add_command(NO_HISTORY, 0, command)
    exact, reference = plant(chassis, state, command, 0.04), make_reference(chassis, car)

    def error(count: int) -> float:
        now, h_ns = state, 40_000_000 // count
        for i in range(count):
            driven = reference.drive(history, now.steer, now.speed, i * h_ns, (i + 1) * h_ns)
            now = State(*reference.propagate(now, driven, QUIET, h_ns * 1e-9).mean.tolist())
        return float(np.abs(np.array(now) - exact)[:6].max())

    coarse, middle, fine = error(4), error(8), error(16)
    assert 3.0 < coarse / middle < 5.5
    assert 3.0 < middle / fine < 5.5


@every_chassis
@pytest.mark.parametrize("state", [STATES[0], STATES[3]])
def test_transition_is_the_derivative_of_the_motion(chassis, state):
    command, h = Command(state.steer + 0.1, state.speed + 0.2), 0.0002
    car = CAR._replace(steer_delay=0.0)
    history = add_command(NO_HISTORY, 0, command)
    reference = make_reference(chassis, car)
    driven = reference.drive(history, state.steer, state.speed, 0, round(h * 1e9))
    transition = reference.propagate(state, driven, QUIET, h).transition
    eps = 1e-5
    for i, name in enumerate(State._fields):
        up = state._replace(**{name: state[i] + eps})
        down = state._replace(**{name: state[i] - eps})
        column = (plant(chassis, up, command, h) - plant(chassis, down, command, h)) / (2.0 * eps)
        np.testing.assert_allclose(transition[:, i], column, atol=1e-4)


@every_chassis
@pytest.mark.parametrize("speed", [0.05, 0.25, 0.4, 0.55])
def test_long_steps_at_low_speed_stay_bounded(chassis, speed):
    """A gap of seconds takes steps far beyond the stability limit of an explicit method."""
    belief = make_belief(np.array([0, 0, 0, speed, 2.0, 0.3, 0.1]), np.eye(7) * 1e-2)
    history = add_command(NO_HISTORY, 0, Command(0.1, speed))
    now = make_reference(chassis).predict(history, belief, 20_000_000, 2_520_000_000)
    moved = now.belief
    assert now.sound
    assert np.isfinite(moved.covariance).all()
    assert np.linalg.eigvalsh(moved.covariance).min() > 0.0
    assert abs(moved.mean[4]) < 0.5
    assert abs(moved.mean[5]) < 0.3


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
