"""A lab's log of a simulated car as CSV with its map, and the session that it becomes."""

import math
from pathlib import Path

import numpy as np

from steerd.car_model.model import Model
from steerd.car_model.native import windows
from steerd.car_model.params import Car
from steerd.daemon.cli.main import run_cli

STEP = 0.01  # time between two rows [s]
NAMES = ("t", "x", "y", "yaw", "steer", "speed")
MAP = """[columns]
t = "t"
x = "x"
y = "y"
yaw = "yaw"
steer_cmd = "steer"
speed_cmd = "speed"
[session]
car = "lab"
"""
FIRST = (0.0, 0.0, 0.3, 1.2, 0.0, 0.0, 0.0)  # the car's state at the first row


def march_states(
    model: Model[float], commands: np.ndarray, first: np.ndarray, step: float
) -> np.ndarray:
    """States (N + 1, 7 + memory) from the first (7,) on, each command (N, 2) held over a step."""
    kernels, count = windows.make_kernels(model.effects), len(commands)
    state = np.zeros((1, 7 + kernels.memory))
    state[0, :7] = first
    held = windows.HeldCommands(np.ascontiguousarray(commands), step)
    blocks = windows.make_window_blocks(np.array([[0, count, 0]]), np.zeros(1))
    path = windows.march(kernels, windows.parameter_vector(model), state, held, blocks, count)
    return windows.view_by_window(path, 1)[0]


def make_noisy_rows(car: Car[float], seconds: float, flips: float) -> np.ndarray:
    """Rows of `NAMES`: steps of steering at `flips` [rad/s] that excite a car, with mocap noise."""
    t = np.arange(round(seconds / STEP)) * STEP
    steer = 0.12 * np.sign(np.sin(flips * t)) + 0.08 * np.sin(2 * np.pi * (0.4 + 0.05 * t) * t)
    commands = np.column_stack([steer, 1.2 + 0.6 * np.sign(np.sin(0.37 * t))])
    poses = march_states(Model(car), commands, FIRST, STEP)[:-1, :3]
    poses += np.random.default_rng(4).normal(size=(len(t), 3)) * [1e-3, 1e-3, 2e-3]
    return np.column_stack([t, poses, commands])


def write_log(folder: Path, rows: np.ndarray, name: str = "run") -> tuple[Path, Path]:
    """The rows as a table, NaN as an empty cell, and its map."""
    table, the_map = folder / f"{name}.csv", folder / "map.toml"
    lines = [",".join("" if math.isnan(v) else repr(float(v)) for v in row) for row in rows]
    table.write_text("\n".join([",".join(NAMES), *lines]) + "\n")
    the_map.write_text(MAP)
    return table, the_map


def import_log(folder: Path, rows: np.ndarray, name: str = "run") -> Path:
    """The session of such a log."""
    table, the_map = write_log(folder, rows, name)
    out = folder / f"{name}.mcap"
    assert run_cli(["import", "csv", str(table), "--map", str(the_map), "-o", str(out)]) == 0
    return out
