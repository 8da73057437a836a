"""How generated pieces are compiled, and where the compiled code is kept."""

from collections.abc import Callable
from typing import Any

import numba

FAST = {"contract", "nsz"}
"""Licences that keep NaN and infinity; reassociation would keep LLVM from vectorising."""


def _njit(**options: Any) -> Any:
    compiler: Any = numba.njit
    return compiler(error_model="numpy", fastmath=FAST, **options)


def point(function: Callable[..., Any]) -> Any:
    """Compile a piece that works on one state, for other pieces to call.

    It gets no wrappers for Python or C, which would cost as much to compile as the piece itself,
    and no place in the cache: it is part of the entries that call it. It makes no arrays: without
    that right, Numba counts no references, whose atomic increments cost more than the equations.
    """
    return _njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False)(function)


def maker(function: Callable[..., Any]) -> Any:
    """Compile a piece that makes arrays, for entries to call once."""
    return _njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


def lanes(function: Callable[..., Any]) -> Any:
    """Compile a piece whose innermost loop runs over windows, for other pieces to call."""
    return point(function)


def entry(function: Callable[..., Any]) -> Any:
    """Compile what Python calls, without its lock; the machine code is kept on disk."""
    return _njit(no_cfunc_wrapper=True, cache=True, nogil=True)(function)
