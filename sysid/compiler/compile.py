"""How generated pieces are compiled, and where the compiled code is kept."""

from collections.abc import Callable
from typing import Any

import numba

FAST = {"contract", "nsz"}
"""Licences that keep NaN and infinity; reassociation would keep LLVM from vectorising."""


def _njit(**options: Any) -> Any:
    compiler: Any = numba.njit
    return compiler(error_model="numpy", fastmath=FAST, **options)


_INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Wrappers for Python or C would cost as much to compile as the piece itself."""


def point(function: Callable[..., Any]) -> Any:
    """Compile a piece that becomes part of the entries that call it.

    It makes no arrays: without that right, Numba counts no references, whose atomic increments cost
    more than the equations. And it is written into its callers: a call would pass seven numbers for
    each array.
    """
    return _njit(**_INNER, _nrt=False, forceinline=True)(function)


def lanes(function: Callable[..., Any]) -> Any:
    """Compile a piece whose innermost loop runs over windows, for other pieces to call."""
    return point(function)


def apart(function: Callable[..., Any]) -> Any:
    """Compile a piece that is called too rarely to be written into its callers."""
    return _njit(**_INNER, _nrt=False)(function)


def maker(function: Callable[..., Any]) -> Any:
    """Compile a piece that makes arrays, for entries to call once."""
    return _njit(**_INNER)(function)


def entry(function: Callable[..., Any]) -> Any:
    """Compile what Python calls, without its lock; the machine code is kept on disk."""
    return _njit(no_cfunc_wrapper=True, cache=True, nogil=True)(function)
