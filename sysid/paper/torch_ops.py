"""`Ops` over torch tensors: batched over windows and runs, everything is differentiable."""

from typing import Any

import torch

from steerd.car_model.ops import Ops

Tensor = torch.Tensor


def _same(a: Tensor, b: Tensor | float) -> Tensor:
    return b if isinstance(b, Tensor) else torch.as_tensor(b, dtype=a.dtype)


class TorchOps:
    """`Ops` over float64 tensors that broadcast against each other."""

    sin = staticmethod(torch.sin)
    cos = staticmethod(torch.cos)
    tan = staticmethod(torch.tan)
    atan = staticmethod(torch.atan)
    tanh = staticmethod(torch.tanh)
    exp = staticmethod(torch.exp)
    sqrt = staticmethod(torch.sqrt)

    @staticmethod
    def absolute(a: Tensor, /) -> Tensor:
        """Magnitude; its derivative at zero is -1, as in the compiled kernels."""
        return torch.where(a > 0.0, a, -a)

    @staticmethod
    def minimum(a: Tensor, b: Tensor | float, /) -> Tensor:
        """The smaller of the two; where they are equal, the second."""
        other = _same(a, b)
        return torch.where(a < other, a, other)

    @staticmethod
    def maximum(a: Tensor, b: Tensor | float, /) -> Tensor:
        """The larger of the two; where they are equal, the second."""
        other = _same(a, b)
        return torch.where(a > other, a, other)

    @classmethod
    def clip(cls, a: Tensor, low: Tensor | float, high: Tensor | float, /) -> Tensor:
        """`a` kept within [low, high]."""
        return cls.minimum(cls.maximum(a, low), high)

    @staticmethod
    def where_positive(
        condition: Tensor, then: Tensor | float, otherwise: Tensor | float, /
    ) -> Tensor:
        """`then` where the condition is strictly positive."""
        return torch.where(condition > 0.0, _same(condition, then), _same(condition, otherwise))


TORCH: Ops[Any] = TorchOps()
