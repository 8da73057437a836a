"""Chamfer distance of two paths as sets of points, whatever the time.

Mean squared distance to the nearest point of the other set, both ways (the definition that the
paper's library, PyTorch3D, uses). A k-d tree finds the nearest points, so thousands are no problem;
given them, the distance is smooth, and its gradient is that of the pairs.
"""

import torch
from scipy.spatial import cKDTree

from steerd.sysid.paper.torch_ops import Tensor


def chamfer(a: Tensor, b: Tensor) -> Tensor:
    """Chamfer distance of two sets of points.

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
