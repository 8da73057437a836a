"""How the compiled text is compiled, and where the machine code is kept."""

# Why: docs/decisions/kernels.md#d55

from collections.abc import Callable
from typing import Any

import numba

FAST = {"contract", "nsz"}
"""Fast-math flags that keep NaN and infinity; reassociation would keep LLVM from vectorising."""


def _njit(**options: Any) -> Any:
    compiler: Any = numba.njit
    return compiler(error_model="numpy", fastmath=FAST, **options)


_INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Wrappers for Python or C would cost as much to compile as the function itself."""


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that becomes part of the entry points that call it.

    It makes no arrays, so Numba may leave out reference counts, whose atomic increments cost more
    than the equations. It is inlined: a call would pass seven numbers for each array.
    """
    return _njit(**_INNER, _nrt=False, forceinline=True)(function)


def not_inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that is called too rarely to be inlined."""
    return _njit(**_INNER, _nrt=False)(function)


def allocating(function: Callable[..., Any]) -> Any:
    """Compile a function that makes arrays, for entry points to call once."""
    return _njit(**_INNER)(function)


def entry_point(function: Callable[..., Any]) -> Any:
    """Compile what Python calls, without the interpreter lock; the machine code goes to disk."""
    return _njit(no_cfunc_wrapper=True, cache=True, nogil=True)(function)
