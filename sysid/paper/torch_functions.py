"""What the paper's loss is made of, as torch functions: simulated paths, distances of two paths.

`simulate` is the compiled simulator, its gradients by the adjoint: any loss on the states can be
minimised. Soft-DTW is a distance whatever the timing: Cuturi and Blondel, "Soft-DTW: a
differentiable loss function for time-series", ICML 2017: the soft minimum
`-gamma log sum exp(-cost / gamma)` over all monotone alignments (algorithm 1). It may be negative.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
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

PAPER_GAMMA = 0.1
"""Softness in the paper [m^2]."""
_FAR = 1e30
"""Cost of what is no cell of the table; infinite ones have no gradient."""


class Marching(NamedTuple):
    """How windows are simulated."""

    h: float  # step of the commands [s]
    integrator: str = "rk4"  # or `euler`
    substeps: int = 1  # integration steps to a command (see `predictor.stable_substeps`)
    history: int = 0  # how many of the commands lie before the first step
    t: float = 0.0  # time into the run at the first step [s]


def simulate(
    kernels: Kernels, parameters: Tensor, first: Tensor, commands: Tensor, how: Marching
) -> Tensor:
    """Simulate windows side by side; equal to `benchmarks.torch_reference`, much faster.

    Args:
        kernels: the compiled car.
        parameters: (P,) float64.
        first: (B, STATES + memory) states; (B, STATES) starts with empty memory.
        commands: (B, history + N, 2), each held over a step.
        how: steps and integrator.

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
    path: Tensor = _Simulate.apply(parameters, first, commands, kernels, how)  # type: ignore[no-untyped-call]
    return path[:, :: how.substeps]


class _Simulate(torch.autograd.Function):
    """March and march back; everything stays in the kernels' layout, so nothing is copied."""

    @staticmethod
    def forward(
        ctx: Any, parameters: Tensor, first: Tensor, commands: Tensor, kernels: Any, how: Any
    ) -> Any:
        """March."""
        values, begin, orders = (
            np.ascontiguousarray(tensor.detach().numpy())
            for tensor in (parameters, first, commands)
        )
        count, length = commands.shape[:2]
        held = HeldCommands(orders.reshape(-1, 2), how.h, how.substeps, how.integrator)
        low = np.arange(count) * length
        runs = np.stack([low, low + length, low + how.history], axis=1)
        blocks = make_window_blocks(runs, np.full(count, how.t))
        steps = (length - how.history) * how.substeps
        path = march(kernels, values, begin, held, blocks, steps)
        ctx.state = (kernels, values, path, held, blocks)
        return view_by_window(torch.from_numpy(path), count)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bars: Tensor) -> Any:
        """March back."""
        kernels, values, path, held, blocks = ctx.state
        wanted = ctx.needs_input_grad[2]
        slopes = march_back(kernels, values, path, bars.numpy(), held, blocks, wanted)
        by_commands = torch.from_numpy(slopes.commands) if wanted else None
        return (
            torch.from_numpy(slopes.parameters),
            torch.from_numpy(np.ascontiguousarray(slopes.first)),
            by_commands if by_commands is None else by_commands.reshape(blocks.windows, -1, 2),
            None, None,
        )  # fmt: skip


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """Squared Euclidean distances (B, N, M) between points (B, N, D) and (B, M, D)."""
    apart = a[:, :, None, :] - b[:, None, :, :]
    return (apart * apart).sum(-1)


def soft_dtw(cost: Tensor, gamma: float = PAPER_GAMMA) -> Tensor:
    """Soft-DTW of cost matrices, diagonal by diagonal: the cells of one do not need each other.

    Args:
        cost: (B, N, M) float64, cost of pairing sample n with sample m.
        gamma: softness, above 0; towards 0 it becomes plain DTW.

    Returns:
        (B,), differentiable.

    Raises:
        ValueError: `gamma` is not above 0.
    """
    if not gamma > 0.0:
        raise ValueError(f"gamma = {gamma:g}: soft-DTW needs a softness above 0")
    count, rows, columns = cost.shape
    n, m = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    diagonals = cost.new_full((count, rows, rows + columns - 1), _FAR)
    diagonals[:, n, n + m] = cost
    # The accumulated cost along the last two diagonals, by row; before the first row lies nothing.
    outside = cost.new_full((count, rows + 1), _FAR)
    before, last = outside.clone(), outside
    before[:, 0] = 0.0
    for here in diagonals.unbind(2):
        ways = torch.stack([before[:, :-1], last[:, :-1], last[:, 1:]])
        reached = here - gamma * torch.logsumexp(-ways / gamma, 0)
        before, last = last, torch.cat([outside[:, :1], reached], 1)
    return last[:, -1]


def chamfer(a: Tensor, b: Tensor) -> Tensor:
    """Chamfer distance of two paths as sets of points, whatever the time.

    Mean squared distance to the nearest point of the other set, both ways (the definition that the
    paper's library, PyTorch3D, uses). A k-d tree finds the nearest points; given them, the distance
    is smooth, and its gradient is that of the pairs.

    Args:
        a: (N, D) float64.
        b: (M, D) float64.

    Returns:
        Scalar [square of the points' unit]; NaN if a point is not finite.
    """
    here, there = a.detach().numpy(), b.detach().numpy()
    if not (torch.isfinite(a).all() and torch.isfinite(b).all()):
        return (a.sum() + b.sum()) * torch.nan
    to_b = torch.from_numpy(cKDTree(there).query(here)[1])
    to_a = torch.from_numpy(cKDTree(here).query(there)[1])
    forth, back = a - b[to_b], b - a[to_a]
    return (forth * forth).sum(-1).mean() + (back * back).sum(-1).mean()
