"""Choices that compile to selects: a branch in a loop body can keep LLVM from vectorising it."""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _signature(count: int) -> Any:
    return types.float64(*(types.float64,) * count)


def _lower(pick: Callable[..., Any]) -> Callable[..., Any]:
    def codegen(_context: Any, builder: ir.IRBuilder, _signature: Any, args: Any) -> Any:
        return pick(builder, *args)

    return codegen


def _select(_typing: Any, _condition: Any, _then: Any, _otherwise: Any) -> Any:
    """`then` where the condition is strictly positive, else `otherwise`."""
    zero = ir.Constant(ir.DoubleType(), 0.0)
    return _signature(3), _lower(lambda b, c, x, y: b.select(b.fcmp_ordered(">", c, zero), x, y))


def _least(_typing: Any, _first: Any, _second: Any) -> Any:
    """The smaller of the two."""
    return _signature(2), _lower(lambda b, x, y: b.select(b.fcmp_ordered("<", x, y), x, y))


def _greatest(_typing: Any, _first: Any, _second: Any) -> Any:
    """The larger of the two."""
    return _signature(2), _lower(lambda b, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))


select: Any = intrinsic(_select)
least: Any = intrinsic(_least)
greatest: Any = intrinsic(_greatest)
