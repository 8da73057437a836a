"""Prints compiled models into the user's cache folder and loads them.

The name of a printed module holds a hash of everything that its compiled code depends on, so a
cache that is older than the equations is never used. Numba keeps the machine code beside it.
"""

import hashlib
import importlib.util
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numba

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.native.trace import trace
from steerd.car_model.single_track import SINGLE_TRACK
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
from steerd.sysid.compiler.disk import at_place, cache_folder, replace_folder, spare_failures


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


def write_module(effects: Sequence[Effect] = (), chassis: Chassis = SINGLE_TRACK) -> Path:
    """Write a model's module unless it is there; several processes may do so at once.

    Raises:
        OSError: the cache folder cannot be written.
    """
    source = module_source(effects, chassis)
    folder = cache_folder() / "kernels"
    path = folder / f"model_{_fingerprint(source)}.py"
    if path.exists():
        return path
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, source)
    except OSError as error:
        raise at_place(error, folder) from None
    return path


@lru_cache(maxsize=256)
def load_module(effects: tuple[Effect, ...] = (), chassis: Chassis = SINGLE_TRACK) -> ModuleType:
    """The compiled module of a car with these effects (compiled on its first calls).

    Raises:
        OSError: neither the cache folder nor a temporary one can be written.
    """
    try:
        return _run_module(write_module(effects, chassis))
    except (OSError, RuntimeError) as error:  # Numba's RuntimeError: no place for machine code
        replace_folder(error)
    return _run_module(write_module(effects, chassis))


def _run_module(path: Path) -> ModuleType:
    name = f"steerd_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be loaded")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    spare_failures(module)
    return module
