"""Number types that the contract tests run the same equations over."""

from typing import Any

import pytest

from steerd.car_model.ops import Ops


@pytest.fixture(scope="session")
def torch_ops() -> Ops[Any]:
    """`Ops` over float64 tensors."""
    from benchmarks.torch_reference import TORCH

    return TORCH
