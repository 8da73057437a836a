"""Soft dynamic time warping: the distance of two paths whatever their timing.

Cuturi and Blondel, "Soft-DTW: a differentiable loss function for time-series", ICML 2017: the soft
minimum `-gamma log sum exp(-cost / gamma)` over all monotone alignments (algorithm 1), and its
exact gradient by the table of expected alignments (algorithm 2). It may be negative.
"""

from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch.autograd.function import once_differentiable

from steerd.sysid.compiler.disk import seal_caches
from steerd.sysid.paper.torch_ops import Tensor

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


@numba.njit(cache=True)
def accumulate(cost: Array, gamma: float) -> Array:
    """Soft-DTW of every pair of beginnings (B, N + 2, M + 2), with a border around."""
    count, rows, columns = cost.shape
    reached = np.full((count, rows + 2, columns + 2), np.inf)
    for b in range(count):
        r = reached[b]
        r[0, 0] = 0.0
        for i in range(1, rows + 1):
            for j in range(1, columns + 1):
                least = min(r[i - 1, j - 1], r[i - 1, j], r[i, j - 1])
                total = np.exp((least - r[i - 1, j - 1]) / gamma)
                total += np.exp((least - r[i - 1, j]) / gamma)
                total += np.exp((least - r[i, j - 1]) / gamma)
                r[i, j] = cost[b, i - 1, j - 1] + least - gamma * np.log(total)
    return reached


@numba.njit(cache=True)
def expect(cost: Array, reached: Array, gamma: float) -> Array:
    """How often each pair (B, N, M) is aligned: the gradient by the costs."""
    count, rows, columns = cost.shape
    expected = np.zeros((count, rows + 2, columns + 2))
    for b in range(count):
        e, r, d = expected[b], reached[b].copy(), np.zeros((rows + 2, columns + 2))
        d[1 : rows + 1, 1 : columns + 1] = cost[b]
        r[rows + 1, :], r[:, columns + 1] = -np.inf, -np.inf
        r[rows + 1, columns + 1] = r[rows, columns]
        e[rows + 1, columns + 1] = 1.0
        for i in range(rows, 0, -1):
            for j in range(columns, 0, -1):
                down = np.exp((r[i + 1, j] - r[i, j] - d[i + 1, j]) / gamma)
                right = np.exp((r[i, j + 1] - r[i, j] - d[i, j + 1]) / gamma)
                both = np.exp((r[i + 1, j + 1] - r[i, j] - d[i + 1, j + 1]) / gamma)
                e[i, j] = e[i + 1, j] * down + e[i, j + 1] * right + e[i + 1, j + 1] * both
    return expected[:, 1 : rows + 1, 1 : columns + 1].copy()


seal_caches(globals())
