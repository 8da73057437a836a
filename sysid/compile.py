"""How generated pieces are compiled, and where the compiled code is kept."""

from collections.abc import Callable
from typing import Any

import numba

FAST = {"contract", "nsz"}
"""Licences that keep NaN and infinity; reassociation would keep LLVM from vectorising."""


def point(function: Callable[..., Any]) -> Any:
    """Compile a piece that works on one state."""
    return numba.njit(error_model="numpy", fastmath=FAST, cache=True)(function)


def lanes(function: Callable[..., Any]) -> Any:
    """Compile a piece whose innermost loop runs over windows."""
    return numba.njit(error_model="numpy", fastmath=FAST, cache=True)(function)
