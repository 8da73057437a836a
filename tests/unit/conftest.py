"""Drives of the compiled car, step by step, with pushes and mocap noise, for the diagnosis."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.car_file import CarFile
from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model, delays, observe
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.rollout import arriving
from steerd.car_model.state import Command, State
from steerd.sim_hw.plant.car import make_steps
from steerd.sysid.data.dataset import Run, Signal, make_run

H = 0.01
LEAD = 100
PUSHES = np.array([0.4, 0.4, 2.5])
POSE_SD = np.array([7e-4, 7e-4, 2e-3])

Drive = Callable[..., list[Run]]


def _orders(ticks: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Steps of speed, and switching or swinging steering below 4.5 m/s^2."""
    speed = np.repeat(rng.uniform(0.9, 3.2, ticks // 120 + 1), 120)[:ticks]
    t = np.arange(ticks) * H
    switching = np.repeat(rng.choice((-1.0, -0.5, 0.0, 0.5, 1.0), ticks // 35 + 1), 35)[:ticks]
    swinging = np.sin(2.0 * np.pi * rng.uniform(0.5, 1.8) * t)
    shape = np.where((t // 3.0) % 2 == 0, switching, swinging)
    most = np.minimum(4.5 * 0.33 / speed**2, 0.3)
    return shape * most, speed


def _drive(text: str, seconds: float, rng: np.random.Generator, name: str, wheel_sd: float) -> Run:
    chosen = parse_effects(text) if text else []
    model = Model(DEFAULT_CAR, tuple(e for e, _ in chosen), tuple(v for _, v in chosen))
    late = delays(model)
    ticks = LEAD + round(seconds / H)
    steer, speed = _orders(ticks, rng)
    x, y, yaw = rng.uniform(-1.0, 1.0, 3)
    steps = make_steps(model, H / 2)
    state, memory = State(x, y, yaw, speed[0], 0.0, 0.0, 0.0), (0.0,) * steps.memory
    held = np.repeat(np.column_stack([steer, speed]), 2, axis=0).tolist()
    orders = [Command(*order) for order in held]
    push, keep, seen = np.zeros(3), np.exp(-H / 0.08), []
    for k in range(ticks):
        seen.append(observe(FLOAT, model, state)[:4])
        for half in (2 * k, 2 * k + 1):
            t, sent = max(half / 2 - LEAD, 0) * H, arriving(orders, half, late, H / 2)
            newer, older = (steps.actuate(*state, *memory, *each, t) for each in sent[:2])
            weighed = (a + w * (b - a) for a, b, w in zip(newer, older, sent.share, strict=True))
            after = steps.glide(1, *state, *memory, *weighed, t)
            state, memory = State(*after[:7]), after[7:]
        push = keep * push + np.sqrt(1 - keep**2) * rng.standard_normal(3) * PUSHES
        state = state._replace(
            speed=state.speed + push[0] * H, yaw_rate=state.yaw_rate + push[2] * H,
            slip_angle=state.slip_angle + push[1] * H / max(state.speed, 0.3),
        )  # fmt: skip
    path, t = np.array(seen), np.arange(ticks) * H
    pose = np.column_stack([np.interp(t - late.pose, t, path[:, i]) for i in range(3)])
    pose += rng.standard_normal(pose.shape) * POSE_SD
    wheel = path[:, 3] + wheel_sd * rng.standard_normal(ticks)
    t = t[: ticks - LEAD]
    seen = [Signal(t, each[LEAD:]) for each in (steer, speed, pose, wheel)]
    return make_run(name, *seen[:3], wheel=seen[3])


drive = pytest.fixture(lambda: simulate_drives, scope="session")


def simulate_drives(text="", runs=4, seconds=8.0, seed=0, wheel_sd=0.02):
    rng = np.random.default_rng(seed)
    return [_drive(text, seconds, rng, f"run-{i}", wheel_sd) for i in range(runs)]


base = pytest.fixture(lambda: make_base(), scope="session")


def make_base() -> CarFile:
    names = (
        "lf", "lr", "c_sf", "c_sr", "inertia_z", "steer_gain", "steer_bias", "steer_delay",
        "steer_lag", "speed_gain", "speed_lag",
    )  # fmt: skip
    return CarFile(Path("car.toml"), "car", DEFAULT_CAR, sd=dict.fromkeys(names, 1e-4))
