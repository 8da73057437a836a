"""Prints compiled models into the user's cache folder and loads them.

The name of a printed module holds a hash of everything that its compiled code depends on, so a
cache that is older than the equations is never used. Numba's machine code is kept beside it.
"""

import builtins
import hashlib
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numba

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.sealed_file import make_own_folder
from steerd.steer_bus.atomic_file import write_atomically
from steerd.sysid.compiler import (
    arguments,
    choice,
    compile,
    delayed,
    forward_sensitivities,
    loops,
    march_windows,
    simd_math,
    simd_rows,
)
from steerd.sysid.compiler.codegen import generate
from steerd.sysid.compiler.disk import at_place, cache_folder, replace_folder, seal_caches
from steerd.sysid.compiler.trace import trace


def _text(module: ModuleType) -> str:
    return Path(str(module.__file__)).read_text(encoding="utf-8")


def module_source(effects: Sequence[Effect] = (), chassis: Chassis = SINGLE_TRACK) -> str:
    """The whole source of a model's module: printed pieces, then the loops around them."""
    loaded = (_text(module) for module in (delayed, loops, forward_sensitivities, march_windows))
    return "\n".join([generate(trace(tuple(effects), chassis)), *loaded])


def _fingerprint(source: str) -> str:
    parts = [
        source,
        *(_text(m) for m in (simd_math, choice, compile, simd_rows, arguments)),
        numba.__version__,
    ]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@lru_cache(maxsize=256)
def load_module(effects: tuple[Effect, ...] = (), chassis: Chassis = SINGLE_TRACK) -> ModuleType:
    """The compiled module of a car with these effects (compiled on its first calls).

    Raises:
        OSError: neither the cache folder nor a temporary one can be written.
    """
    source = module_source(effects, chassis)
    try:
        return _run_module(source)
    except (OSError, RuntimeError) as error:  # Numba's RuntimeError: no place for machine code
        replace_folder(error)
    return _run_module(source)


def _run_module(source: str) -> ModuleType:
    """The module of a source; it is written for Numba, which wants a file, and never read back."""
    folder = cache_folder() / "kernels"
    path = folder / f"model_{_fingerprint(source)}.py"
    try:
        make_own_folder(folder)
        if not path.exists():
            write_atomically(path, source)
    except OSError as error:
        raise at_place(error, folder) from None
    module = ModuleType(f"steerd_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    exec(builtins.compile(source, path, "exec"), vars(module))
    seal_caches(vars(module))
    return module
