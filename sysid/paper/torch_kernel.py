"""The compiled simulator as a torch function: any loss on the states, gradients by the adjoint."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from steerd.car_model.native.windows import (
    STATES,
    HeldCommands,
    Kernels,
    make_window_blocks,
    march,
    march_back,
    view_by_window,
)


def simulate(
    kernels: Kernels,
    parameters: Tensor,
    first: Tensor,
    commands: Tensor,
    h: float,
    *,
    integrator: str = "rk4",
    substeps: int = 1,
    history: int = 0,
    t: float = 0.0,
) -> Tensor:
    """Simulate windows side by side; equal to `benchmarks.torch_reference`, much faster.

    Args:
        kernels: the compiled car.
        parameters: (P,) float64.
        first: (B, STATES + memory) states; (B, STATES) starts with empty memory.
        commands: (B, history + N, 2), each held over a step.
        h: step [s].
        integrator: `rk4` or `euler`.
        substeps: integration steps to a command (see `predictor.stable_substeps`).
        history: how many of the commands lie before the first step.
        t: time into the run at the first step [s].

    Returns:
        (B, N + 1, STATES + memory) states; a view whose innermost axis in memory is B.

    Raises:
        TypeError: a tensor is not float64.
    """
    if {parameters.dtype, first.dtype, commands.dtype} != {torch.float64}:
        raise TypeError("parameters, first states and commands must be float64")
    missing = STATES + kernels.memory - first.shape[-1]
    if missing:
        first = torch.nn.functional.pad(first, (0, missing))
    setting = (kernels, h, integrator, substeps, history, t)
    path: Tensor = _Simulate.apply(parameters, first, commands, setting)  # type: ignore[no-untyped-call]
    return path[:, ::substeps] if substeps > 1 else path


class _Simulate(torch.autograd.Function):
    """March and march back; everything stays in the kernels' layout, so nothing is copied."""

    @staticmethod
    def forward(ctx: Any, parameters: Tensor, first: Tensor, commands: Tensor, setting: Any) -> Any:
        """March."""
        kernels, h, integrator, substeps, history, t = setting
        count, length = commands.shape[:2]
        held = HeldCommands(_array(commands).reshape(-1, 2), h, substeps, integrator)
        low = np.arange(count) * length
        runs = np.stack([low, low + length, low + history], axis=1)
        blocks = make_window_blocks(runs, np.full(count, t))
        steps = (length - history) * substeps
        path = march(kernels, _array(parameters), _array(first), held, blocks, steps)
        ctx.state = (kernels, _array(parameters), path, held, blocks)
        return view_by_window(torch.from_numpy(path), count)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bars: Tensor) -> Any:
        """March back."""
        kernels, parameters, path, held, blocks = ctx.state
        wanted = ctx.needs_input_grad[2]
        slopes = march_back(kernels, parameters, path, bars.numpy(), held, blocks, wanted)
        pieces = [slopes.parameters, np.ascontiguousarray(slopes.first)]
        if wanted:
            pieces.append(slopes.commands.reshape(blocks.windows, -1, 2))
        gradients = [torch.from_numpy(piece) for piece in pieces]
        return (*gradients, *[None] * (4 - len(gradients)))


def _array(tensor: Tensor) -> Any:
    return np.ascontiguousarray(tensor.detach().numpy())
