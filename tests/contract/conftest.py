"""Number types that the contract tests run the same equations over."""

from typing import Any

import pytest
import torch


class TorchOps:
    """`Ops` over float64 tensors, written for these tests alone (sysid has its own)."""

    sin = staticmethod(torch.sin)
    cos = staticmethod(torch.cos)
    tan = staticmethod(torch.tan)
    atan = staticmethod(torch.atan)
    tanh = staticmethod(torch.tanh)
    exp = staticmethod(torch.exp)
    sqrt = staticmethod(torch.sqrt)
    absolute = staticmethod(torch.abs)

    @staticmethod
    def minimum(a: Any, b: Any, /) -> Any:
        return torch.minimum(a, torch.as_tensor(b, dtype=torch.float64))

    @staticmethod
    def maximum(a: Any, b: Any, /) -> Any:
        return torch.maximum(a, torch.as_tensor(b, dtype=torch.float64))

    @classmethod
    def clip(cls, a: Any, low: Any, high: Any, /) -> Any:
        return cls.minimum(cls.maximum(a, low), high)

    @staticmethod
    def where_positive(condition: Any, then: Any, otherwise: Any, /) -> Any:
        return torch.where(condition > 0.0, then, otherwise)


@pytest.fixture(scope="session")
def torch_ops() -> TorchOps:
    """`Ops` over float64 tensors."""
    return TorchOps()
