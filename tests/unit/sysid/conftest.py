"""Drives whose truth is known: the compiled car driven over excitation plans, with seeded noise."""

import numpy as np
import pytest

from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.paper import PAPER_CAR_DIRECT
from tests.csv_logs import march_states

STEP = 0.005
TRUTH = DEFAULT_CAR._replace(
    lf=0.16, lr=0.172, inertia_z=0.05, steer_gain=0.96, steer_bias=0.01, steer_delay=0.013,
    steer_lag=0.06, speed_gain=1.02, speed_lag=0.12,
)  # fmt: skip
"""A car that differs from the default in every parameter that is free by default, tyres apart."""
POSE_SD, WHEEL_SD = np.array([1e-3, 1e-3, 2e-3]), 0.02


def mixed_commands(seconds: float, seed: int, lateral: float = 5.0) -> Array:
    """Steps, sines and chirps of steering at 1 to 3 m/s, no faster than the daemon's limit."""
    rng, count, i = np.random.default_rng(seed), round(seconds / STEP), 0
    steer, speed = np.zeros((2, count))
    while i < count:
        n = min(int(rng.uniform(0.4, 2.0) / STEP), count - i)
        v, kind, t = rng.uniform(1.0, 3.0), rng.integers(3), np.arange(n) * STEP
        limit = min(0.34, float(np.arctan(0.33 * lateral / v**2)))
        size = rng.uniform(-limit, limit)
        shapes = (np.ones(n), np.sin(2 * np.pi * rng.uniform(0.4, 2.5) * t),
                  np.sin(2 * np.pi * (0.5 + t) * t))  # fmt: skip
        steer[i : i + n], speed[i : i + n] = size * shapes[kind], v
        i += n
    for k in range(1, count):
        steer[k] = min(max(steer[k], steer[k - 1] - 2.8 * STEP), steer[k - 1] + 2.8 * STEP)
    return np.column_stack([steer, speed])


def simulate_run(model, commands, first, seed):
    """A drive of a known car, poses and wheel speed at 200 Hz."""
    count, path = len(commands), march_states(model, commands, first, STEP)
    rng, t = np.random.default_rng([7, seed]), np.arange(count + 1) * STEP
    pose = path[:, :3] + rng.normal(size=(count + 1, 3)) * POSE_SD
    wheel = path[:, 3] / model.car.speed_gain + rng.normal(size=count + 1) * WHEEL_SD
    asked = (Signal(t[:-1], each) for each in commands.T)
    return make_run(f"run {seed}", *asked, Signal(t, pose), wheel=Signal(t, wheel), h=STEP)


def drive(model, seconds, seed, speed=None):
    """A mixed drive from 1.5 m/s straight ahead; all of it at one speed where one is given."""
    first = np.array([0.0, 0.0, 0.0, speed or 1.5, 0.0, 0.0, 0.0])
    commands = mixed_commands(seconds, seed)
    if speed is not None:
        commands[:, 1] = speed
    return simulate_run(model, commands, first, seed)


def circle_runs(count: int = 6, seconds: float = 4.0) -> list[Run]:
    """The paper's circles: left and right at the stop, 1 m/s, turning from the start."""
    car, runs = Model(PAPER_CAR_DIRECT), []
    for i in range(count):
        steer = 0.34 if i % 2 else -0.34
        commands = np.tile([steer, 1.0], (round(seconds / STEP), 1))
        begin = np.array([0.3 * i, 0.2, 0.7 * i, 1.0, 0.0, 0.0, steer])
        settled = march_states(car, commands[:300], begin, STEP)[-1]
        runs.append(simulate_run(car, commands, settled, i))
    return runs


truth = pytest.fixture(lambda: Model(TRUTH), scope="session")
make_drive = pytest.fixture(lambda: drive, scope="session")
make_circles = pytest.fixture(lambda: circle_runs, scope="session")
simulated = pytest.fixture(lambda: simulate_run, scope="session")


@pytest.fixture(scope="session")
def rich_model() -> Model[float]:
    """Memory, a linkage, two delays and time-dependent grip, all away from their nulls."""
    text = "grip_drift=0.5,1,mocap_latency=0.0021,steer_backlash=0.02,steer_delay=0.011"
    effects, values = zip(*parse_effects(f"{text},tyre_relaxation=0.07"), strict=True)
    car = DEFAULT_CAR._replace(steer_delay=0.0128, drive_delay=0.004, pose_delay=0.0033)
    return Model(car, effects, values)
