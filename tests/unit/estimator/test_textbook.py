"""The filter against an extended Kalman filter written from the textbook, sharing only the plant.

Motion by RK4 in 1 ms steps, Jacobians by central differences, covariance in its plain form, events
in order of validity, no gates, no buffer: slow, plain, and independent of `estimator`.
"""

import math
from typing import Any

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.rollout import start
from steerd.car_model.rollout import step as plant_step
from steerd.car_model.state import Command, State
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import Kind
from steerd.estimator.state_filter import make_state_filter, predict_to, step
from tests.textbook import noise_densities

CAR = DEFAULT_CAR
CONFIG = FilterConfig(gate_probability=1.0 - 1e-9)
MS = 1_000_000
ROWS = {Kind.POSE: [0, 1, 2], Kind.WHEEL_SPEED: [3], Kind.GYRO: [4]}
SDS = {
    Kind.POSE: [CONFIG.pose_position_sd, CONFIG.pose_position_sd, CONFIG.pose_yaw_sd],
    Kind.WHEEL_SPEED: [CONFIG.wheel_speed_sd],
    Kind.GYRO: [CONFIG.gyro_sd],
}


def textbook_motion(x: np.ndarray, command: Command[float]) -> np.ndarray:
    moment = start(Model(CAR), State(*x.tolist()), 0.0)
    return np.array(plant_step(FLOAT, Model(CAR), moment, command, 0.0, 0.001).state)


def textbook_predict(
    x: np.ndarray, P: np.ndarray, command: Command[float]
) -> tuple[np.ndarray, np.ndarray]:
    columns = [
        (textbook_motion(x + unit, command) - textbook_motion(x - unit, command)) / 2e-6
        for unit in np.eye(7) * 1e-6
    ]
    F = np.array(columns).T
    Q = 0.001 * np.diag(np.square(noise_densities(CONFIG, x[3])))
    return textbook_motion(x, command), F @ P @ F.T + 0.5 * (F @ Q @ F.T + Q)


def textbook_update(
    x: np.ndarray, P: np.ndarray, kind: Kind, z: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
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
    flt = make_state_filter(CAR, CONFIG)
    runs = list(run_filter(flt, drive))
    begin = next(state for _, state in runs if state.nodes).nodes[0]
    events = sorted(m for _, m in drive.arrivals if m > begin.measurement)
    end_ns = runs[-1][0]
    x, P = begin.belief.mean, begin.belief.covariance
    delay = round(CAR.steer_delay * 1e9)
    commands = dict(drive.commands)
    first = drive.commands[0][0]

    def sent(t_ns: int) -> Command[float]:
        return commands[max(t_ns - (t_ns - first) % (5 * MS), first)]

    for t in range(begin.measurement.t_ns, end_ns + 1, MS):
        while events and events[0].t_ns <= t:
            x, P = textbook_update(x, P, events[0].kind, events[0].values)
            events.pop(0)
        if t < end_ns:
            x, P = textbook_predict(x, P, Command(sent(t - delay).steer, sent(t).speed))
    final = make_final(flt, runs[-1][1], drive, end_ns)
    np.testing.assert_allclose(final.sd, np.sqrt(np.diag(P)), rtol=0.02)
    assert (np.abs(np.array(final.state) - x) < 0.05 * np.array(final.sd)).all()


def make_final(flt: Any, state: Any, drive: Any, end_ns: int) -> Any:
    """The estimate once what was still under way at the end has arrived too."""
    rest = [m for arrival, m in drive.arrivals if arrival > end_ns]
    estimate = predict_to(flt, step(flt, state, end_ns, rest), end_ns)
    assert estimate is not None
    return estimate
