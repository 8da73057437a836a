import numpy as np
import pytest

from steerd.car_model.jacobian_generated import rates_and_jacobian
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.rollout import simulate as simulate_car
from steerd.car_model.rollout import start
from steerd.car_model.state import Command, State
from steerd.estimator.actuation import NO_HISTORY, ActuatorMotion, add_command, drive
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Belief, Kalman
from steerd.estimator.motion import implicit_solver, noise_density, predict_belief, propagate

CAR = DEFAULT_CAR
QUIET = [0.0] * 7
STATES = [
    State(1.0, -2.0, 0.7, 2.0, 1.1, -0.04, 0.12),
    State(0.0, 0.0, -3.0, 0.35, -0.3, 0.05, -0.2),
    State(0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.1),
    State(5.0, 1.0, 9.0, 4.5, -2.0, 0.02, -0.05),
    State(0.0, 0.0, 0.3, -0.6, 0.2, 0.01, 0.2),
]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("car", [DEFAULT_CAR, PAPER_CAR])
def test_sparse_solution_equals_the_dense_one(car, state) -> None:
    _, rows = rates_and_jacobian(car, state, 0.1, 0.5)
    for k in (0.0005, 0.005):
        dense = np.linalg.inv(np.eye(6) - k * np.array(rows)[:, :6])
        solve = implicit_solver(rows, k)
        for column in range(2, 6):
            np.testing.assert_allclose(
                solve(*np.eye(6)[column][2:]), dense[:, column], rtol=1e-12, atol=1e-15
            )
        np.testing.assert_allclose(dense[:, :2], np.eye(6)[:, :2], atol=1e-15)


@pytest.mark.parametrize("state", STATES)
def test_step_is_the_implicit_midpoint_of_the_whole_jacobian(state) -> None:
    driven = ActuatorMotion(0.13, 0.11, 0.7, 0.9, 0.95, -8.0)
    h = 0.008
    rates, rows = rates_and_jacobian(CAR, state, driven.wheel, driven.accel)
    J = np.array(rows)
    W = np.linalg.inv(np.eye(6) - 0.5 * h * J[:, :6])
    F = np.zeros((7, 7))
    F[:6, :6] = W @ (np.eye(6) + 0.5 * h * J[:, :6])
    F[:6, 3] += h * W @ J[:, 7] * driven.accel_by_speed
    F[:6, 6] = h * W @ J[:, 6] * driven.wheel_by_steer
    F[6, 6] = driven.steer_by_steer
    mean, transition, _ = propagate(CAR, state, driven, QUIET, h)
    np.testing.assert_allclose(transition, F, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(mean[:6], np.array(state[:6]) + h * W @ np.array(rates), rtol=1e-12)
    assert mean[6] == driven.steer


def plant(state: State[float], command: Command[float], seconds: float) -> np.ndarray:
    """RK4 at 0.1 ms under a constant command."""
    model = Model(CAR._replace(steer_delay=0.0))
    count = round(seconds / 1e-4)
    return np.array(
        simulate_car(FLOAT, model, start(model, state, 0.0), [command] * count, 1e-4)[-1].state
    )


@pytest.mark.parametrize("state", [STATES[0], STATES[3]])
def test_error_falls_with_the_square_of_the_step(state) -> None:
    command = Command(state.steer + 0.1, state.speed + 0.2)  # within the slew limits
    car = CAR._replace(steer_delay=0.0)
    history = add_command(NO_HISTORY, 0, command)
    exact = plant(state, command, 0.04)

    def error(count: int) -> float:
        now, h_ns = state, 40_000_000 // count
        for i in range(count):
            driven = drive(car, history, now.steer, now.speed, i * h_ns, (i + 1) * h_ns)
            now = State(*propagate(car, now, driven, QUIET, h_ns * 1e-9).mean.tolist())
        return float(np.abs(np.array(now) - exact)[:6].max())

    coarse, middle, fine = error(4), error(8), error(16)
    assert 3.0 < coarse / middle < 5.5
    assert 3.0 < middle / fine < 5.5


@pytest.mark.parametrize("state", [STATES[0], STATES[3]])
def test_transition_is_the_derivative_of_the_motion(state) -> None:
    command, h = Command(state.steer + 0.1, state.speed + 0.2), 0.0002
    car = CAR._replace(steer_delay=0.0)
    history = add_command(NO_HISTORY, 0, command)
    driven = drive(car, history, state.steer, state.speed, 0, round(h * 1e9))
    transition = propagate(car, state, driven, QUIET, h).transition
    eps = 1e-5
    for i, name in enumerate(State._fields):
        up = state._replace(**{name: state[i] + eps})
        down = state._replace(**{name: state[i] - eps})
        column = (plant(up, command, h) - plant(down, command, h)) / (2.0 * eps)
        np.testing.assert_allclose(transition[:, i], column, atol=1e-4)


@pytest.mark.parametrize("speed", [0.05, 0.25, 0.4, 0.55])
def test_long_steps_at_low_speed_stay_bounded(speed: float) -> None:
    """A gap of seconds takes steps far beyond the stability limit of an explicit method."""
    belief = Belief(np.array([0, 0, 0, speed, 2.0, 0.3, 0.1]), np.eye(7) * 1e-2)
    history = add_command(NO_HISTORY, 0, Command(0.1, speed))
    moved = predict_belief(
        Kalman(7), CAR, FilterConfig(), history, belief, 20_000_000, 2_520_000_000
    )
    assert np.isfinite(moved.covariance).all()
    assert np.linalg.eigvalsh(moved.covariance).min() > 0.0
    assert abs(moved.mean[4]) < 0.5
    assert abs(moved.mean[5]) < 0.3


def test_no_time_no_motion() -> None:
    belief = Belief(np.arange(7.0), np.eye(7))
    assert predict_belief(Kalman(7), CAR, FilterConfig(), NO_HISTORY, belief, 5, 5) is belief


def test_noise_is_that_of_accelerations() -> None:
    config = FilterConfig()
    fast, slow = noise_density(config, 2.0), noise_density(config, 0.0)
    assert fast[3] == config.longitudinal_accel_density**2
    assert fast[5] == pytest.approx((config.lateral_accel_density / 2.0) ** 2)
    assert slow[5] == pytest.approx((config.lateral_accel_density / 0.5) ** 2)
    assert noise_density(config, -2.0) == fast
    assert noise_density(config, 2.0, steered=False) == [*fast[:6], 0.0]


@pytest.mark.parametrize("state", STATES)
def test_noise_enters_evenly_along_the_step(state) -> None:
    """`Q` is the integral of noise carried on by an `F` that grows linearly, summed in pieces."""
    density = noise_density(FilterConfig(), state.speed)
    h, pieces = 0.008, 2000
    _, F, Q = propagate(CAR, state, ActuatorMotion(0.13, 0.11, 0.7, 0.9, 0.95, -8.0), density, h)
    total = np.zeros((7, 7))
    for s in (np.arange(pieces) + 0.5) / pieces:
        carried = np.eye(7) + s * (F - np.eye(7))
        total += carried @ np.diag(density) @ carried.T * h / pieces
    np.testing.assert_allclose(Q, total, rtol=1e-5, atol=1e-12)
    assert (Q == Q.T).all()
