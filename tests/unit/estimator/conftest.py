"""A car that obeys the filter's own assumptions, and its instruments: what consistency is shown on.

The plant is the compiled car's RK4 at 2.5 ms with white noise of the configured densities;
commands at 200 Hz, wheel speed at 200 Hz, poses at 100 Hz that arrive 6 ms after their exposure.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from steerd.car_model.chassis import Chassis
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command, State
from steerd.estimator import state_filter
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import Measurement, make_gyro, make_pose, make_wheel_speed
from steerd.sim_hw.plant.car import make_steps
from tests.textbook import noise_densities

H_NS = 2_500_000
TICK_NS = 5_000_000
EPOCH_NS = 1_000_000_000_000
POSE_LATENCY_NS = 6_000_000
POSE_LOSS = 0.05  # share of the poses

Plan = Callable[[float], Command[float]]


def slalom(t: float) -> Command[float]:
    """Weaving between 1.2 and 2.8 m/s, with steps in both channels."""
    steer = 0.15 * math.sin(2.0 * math.pi * 0.7 * t) + (0.08 if t % 2.0 < 0.6 else -0.02)
    return Command(steer, 2.0 + 0.8 * math.sin(2.0 * math.pi * 0.3 * t))


@dataclass(frozen=True)
class Drive:
    truth: dict[int, State[float]]  # by time [ns], every tick
    commands: list[tuple[int, Command[float] | None]]
    arrivals: list[tuple[int, Measurement]]  # (time of arrival, measurement) in order of arrival


def disturb(state: State[float], config: FilterConfig, h: float, noise: np.ndarray) -> State[float]:
    """White noise of `h` seconds. Half before and half after each step keeps second order."""
    densities = noise_densities(config, state.speed)
    return State(*(np.array(state) + math.sqrt(h) * densities * noise).tolist())


def simulated_drive(
    seed: int, seconds: float, plan: Plan = slalom, car: Car[float] = DEFAULT_CAR,
    config: FilterConfig | None = None, *, first: State[float] | None = None,
    gyro: bool = False, chassis: Chassis = SINGLE_TRACK,
) -> Drive:  # fmt: skip
    config = config or FilterConfig()
    rng = np.random.default_rng(seed)
    h = H_NS * 1e-9
    plant, state = make_steps(Model(car, chassis=chassis), h), first or ORIGIN._replace(speed=2.0)
    truth: dict[int, State[float]] = {}
    commands: list[tuple[int, Command[float] | None]] = []
    arrivals: list[tuple[int, Measurement]] = []
    count = round(seconds * 1e9) // H_NS
    late_steer, late_drive = round(car.steer_delay * 1e9), round(car.drive_delay * 1e9)
    for k in range(count + 1):
        t_ns = EPOCH_NS + k * H_NS
        if (t_ns - EPOCH_NS) % TICK_NS == 0:
            truth[t_ns] = state
            commands.append((t_ns, plan((t_ns - EPOCH_NS) * 1e-9)))
            arrivals += _readings(rng, car, config, t_ns, state, gyro)
        steering = _sent(plan, t_ns - late_steer)
        driving = _sent(plan, t_ns - late_drive)
        state = disturb(state, config, 0.5 * h, rng.standard_normal(7))
        state = State(*plant.follow(*state, steering.steer, driving.speed, k * h))
        state = disturb(state, config, 0.5 * h, rng.standard_normal(7))
    return Drive(truth, commands, sorted(arrivals, key=lambda pair: pair[0]))


def _sent(plan: Plan, t_ns: int) -> Command[float]:
    """The command in force: of the last tick, of the first one before the first."""
    tick = max((t_ns - EPOCH_NS) // TICK_NS, 0)
    return plan(tick * TICK_NS * 1e-9)


def _readings(rng, car, config, t_ns, state, gyro):
    n = rng.standard_normal(6)
    wheel = state.speed / car.speed_gain + config.wheel_speed_sd * n[0]
    yield t_ns, make_wheel_speed(t_ns, wheel)
    if gyro:
        yield t_ns, make_gyro(t_ns, state.yaw_rate + config.gyro_sd * n[4])
    if (t_ns - EPOCH_NS) % (2 * TICK_NS) == 0 and rng.random() >= POSE_LOSS:
        sd = config.pose_position_sd
        x, y = state.x + sd * n[1], state.y + sd * n[2]
        yaw = math.remainder(state.yaw + config.pose_yaw_sd * n[3], math.tau)
        yield t_ns + POSE_LATENCY_NS, make_pose(t_ns - round(car.pose_delay * 1e9), x, y, yaw)


def filtered(flt, drive, begin=None):
    """The filter's state at every tick, fed as the daemon feeds it."""
    state = begin or state_filter.FilterState()
    waiting = deque(drive.arrivals)
    for t_ns, command in drive.commands:
        batch = []
        while waiting and waiting[0][0] <= t_ns:
            batch.append(waiting.popleft()[1])
        state = state_filter.step(flt, state, t_ns, batch, ((t_ns, command),))
        yield t_ns, state


simulate = pytest.fixture(lambda: simulated_drive, scope="session")
run_filter = pytest.fixture(lambda: filtered, scope="session")
drive = pytest.fixture(lambda: simulated_drive(seed=7, seconds=3.0), scope="session")
