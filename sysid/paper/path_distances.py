"""Distances of two paths: soft dynamic time warping and chamfer, the two parts of the paper's loss.

Soft-DTW is a distance whatever the timing: Cuturi and Blondel, "Soft-DTW: a differentiable loss
function for time-series", ICML 2017: the soft minimum `-gamma log sum exp(-cost / gamma)` over all
monotone alignments (algorithm 1), and its exact gradient by the table of expected alignments
(algorithm 2). It may be negative.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor
from torch.autograd.function import once_differentiable

Array = NDArray[np.float64]

PAPER_GAMMA = 0.1
"""Softness in the paper [m^2]."""


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
