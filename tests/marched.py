"""The compiled car under commands, without noise."""

import numpy as np

from steerd.car_model.model import Model
from steerd.car_model.native import windows


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
