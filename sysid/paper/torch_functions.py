"""What the paper's loss is made of, as torch functions: simulated paths, distances of two paths.

`simulate` is the compiled simulator, its gradients by the adjoint: any loss on the states can be
minimised. Soft-DTW is a distance whatever the timing: Cuturi and Blondel, "Soft-DTW: a
differentiable loss function for time-series", ICML 2017: the soft minimum
`-gamma log sum exp(-cost / gamma)` over all monotone alignments (algorithm 1), and its exact
gradient by the table of expected alignments (algorithm 2). It may be negative.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
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

Array = NDArray[np.float64]

PAPER_GAMMA = 0.1
"""Softness in the paper [m^2]."""


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


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """Squared Euclidean distances (B, N, M) between points (B, N, D) and (B, M, D)."""
    apart = a[:, :, None, :] - b[:, None, :, :]
    return (apart * apart).sum(-1)


def soft_dtw(cost: Tensor, gamma: float = PAPER_GAMMA) -> Tensor:
    """Soft-DTW of cost matrices.

    Args:
        cost: (B, N, M) float64, cost of pairing sample n with sample m.
        gamma: softness, above 0; towards 0 it becomes plain DTW.

    Returns:
        (B,), differentiable once.

    Raises:
        ValueError: `gamma` is not above 0.
    """
    if not gamma > 0.0:
        raise ValueError(f"gamma = {gamma:g}: soft-DTW needs a softness above 0")
    value: Tensor = _SoftDtw.apply(cost, gamma)  # type: ignore[no-untyped-call]
    return value


class _SoftDtw(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, cost: Tensor, gamma: float) -> Tensor:
        """Accumulated soft minima."""
        table = np.ascontiguousarray(cost.detach().numpy())
        reached = accumulate(table, gamma)
        ctx.state = (table, reached, gamma)
        return torch.from_numpy(reached[:, -2, -2].copy())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bars: Tensor) -> Any:
        """Expected alignment times the incoming gradient."""
        return torch.from_numpy(expect(*ctx.state)) * bars[:, None, None], None


def _diagonals(rows: int, columns: int) -> Iterator[tuple[int, int, int]]:
    """Cells (i, total - i), which do not need each other: total, first and last i, from 1."""
    for total in range(2, rows + columns + 1):
        yield total, max(1, total - columns), min(rows, total - 1)


def _along(table: Array, row: int, column: int, count: int) -> Array:
    """View (B, count) of the cells of a diagonal that runs down and to the left."""
    width = table.shape[2]
    start = row * width + column
    return table.reshape(len(table), -1)[:, start : start + count * (width - 1) : width - 1]


def accumulate(cost: Array, gamma: float) -> Array:
    """Soft-DTW of every pair of beginnings (B, N + 2, M + 2), with a border around."""
    count, rows, columns = cost.shape
    reached = np.full((count, rows + 2, columns + 2), np.inf)
    reached[:, 0, 0] = 0.0
    costs = np.zeros_like(reached)
    costs[:, 1:-1, 1:-1] = cost
    for total, i, last in _diagonals(rows, columns):
        j, size = total - i, last - i + 1
        before = [_along(reached, i - a, j - b, size) for a, b in ((1, 1), (1, 0), (0, 1))]
        least = np.minimum(np.minimum(before[0], before[1]), before[2])
        weights = sum(np.exp((least - each) / gamma) for each in before)
        _along(reached, i, j, size)[:] = _along(costs, i, j, size) + least - gamma * np.log(weights)
    return reached


def expect(cost: Array, reached: Array, gamma: float) -> Array:
    """How often each pair (B, N, M) is aligned: the gradient by the costs."""
    rows, columns = cost.shape[1:]
    expected, r, d = np.zeros_like(reached), reached.copy(), np.zeros_like(reached)
    d[:, 1:-1, 1:-1] = cost
    r[:, -1, :], r[:, :, -1] = -np.inf, -np.inf
    r[:, -1, -1] = r[:, rows, columns]
    expected[:, -1, -1] = 1.0
    for total, i, last in reversed(list(_diagonals(rows, columns))):
        j, size = total - i, last - i + 1
        here = _along(r, i, j, size)
        _along(expected, i, j, size)[:] = sum(
            _along(expected, i + a, j + b, size)
            * np.exp((_along(r, i + a, j + b, size) - here - _along(d, i + a, j + b, size)) / gamma)
            for a, b in ((1, 0), (0, 1), (1, 1))
        )
    return expected[:, 1:-1, 1:-1].copy()


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
