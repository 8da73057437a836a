"""Loads the compiled library, with the functions that suit this processor."""

import ctypes
import hashlib
import platform
from ctypes import POINTER, c_double, c_int64, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect

LIBRARY = Path(__file__).with_name("equations.so")
LEVELS: dict[str, dict[str, str]] = {
    "x86_64": {"v4": "x86-64-v4", "v3": "x86-64-v3", "v1": "x86-64"}
}
"""Processor levels by machine, best first: name in the library, the compilers' name."""
_FEATURES = {
    "v4": {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
    "v3": {"avx2", "bmi2", "fma"},
}
"""What a level needs, as Linux calls it."""
_OTHERS = {"car_file.py", "library.py", "threads.py", "windows.py"}
"""Files of `car_model` that the library is not made from."""

Structure = ctypes.Structure


class LibraryError(Exception):
    """The library cannot be used; the message says what to do."""


class Integration(Structure):
    """The car's numbers and how it is integrated; see `march.h`, like the others."""

    _fields_ = (
        ("p", c_void_p), ("q", c_void_p), ("tableau", c_void_p),
        ("h", c_double), ("stages", c_int64), ("substeps", c_int64),
    )  # fmt: skip


class Block(Structure):
    """Windows side by side."""

    _fields_ = (("commands", c_void_p), ("spans", c_void_p), ("t", c_void_p))


class Directions(Structure):
    """What derivatives are taken by."""

    _fields_ = (
        ("n", c_int64), ("moved", c_void_p), ("seeds", c_void_p),
        ("first", c_void_p), ("delays", c_void_p),
    )  # fmt: skip


class Readings(Structure):
    """Where windows are read, and where to."""

    _fields_ = (
        ("stations", c_void_p), ("shares", c_void_p), ("ranges", c_void_p),
        ("y", c_void_p), ("jy", c_void_p),
    )  # fmt: skip


class Filter(Structure):
    """What does not change while a filter runs; see `filter.h`."""

    _fields_ = (
        ("p", c_void_p), ("q", c_void_p), ("density", c_void_p), ("sensors", c_void_p),
        ("steer_late", c_int64), ("drive_late", c_int64),
    )  # fmt: skip


class Loss(Structure):
    """Derivatives of a loss by every state."""

    _fields_ = (
        ("values", c_void_p), ("by_window", c_int64), ("by_moment", c_int64),
        ("by_state", c_int64), ("windows", c_int64), ("slot", c_int64),
    )  # fmt: skip


_ARGUMENTS: dict[str, list[Any]] = {
    "march": [POINTER(Integration), POINTER(Block), c_int64, c_int64, c_void_p],
    "march_back": [
        POINTER(Integration), POINTER(Block), c_int64, c_int64, c_void_p, POINTER(Loss),
        *[c_void_p] * 4,
    ],
    "settled": [POINTER(Integration), POINTER(Block), c_void_p],
    "readings": [
        POINTER(Integration), POINTER(Block), POINTER(Directions), c_void_p, POINTER(Readings)
    ],
    "follow": [POINTER(Integration), c_void_p, c_void_p],
    "actuated": [POINTER(Integration), c_void_p, c_void_p],
    "glide": [POINTER(Integration), c_void_p, c_void_p],
    "delays": [c_void_p] * 4,
    "constants": [c_void_p, c_double, c_void_p],
    "constant_count": [],
    "fuse": [POINTER(Filter), c_void_p, c_void_p],
    "predict": [POINTER(Filter), c_void_p, c_void_p],
    "tangent": [c_void_p] * 3,
    "filter_constants": [c_void_p, c_double, c_void_p],
    "filter_constant_count": [],
}  # fmt: skip
_SHORT = ("follow", "actuated", "glide", "fuse", "predict", "tangent")
"""Functions that keep Python's lock: another thread would not give it back before milliseconds."""


def model_label(effects: tuple[Effect, ...], chassis: Chassis) -> str:
    """What a model's functions begin with: those of a car with any effect hold every one."""
    return f"{chassis.label}_{'every' if effects else 'plain'}"


@cache
def _level() -> str:
    levels = LEVELS.get(platform.machine())
    if levels is None:
        return "plain"
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    flags = set(next((line for line in text.splitlines() if line.startswith("flags")), "").split())
    return next(level for level in levels if _FEATURES.get(level, set()) <= flags)


def fingerprint() -> str:
    """A digest of all that the library is made from."""
    folder, found = LIBRARY.parent.parent, hashlib.sha256()
    parts = (*folder.glob("*.py"), *folder.glob("effects/**/*.py"), *folder.glob("native/*.[hp]*"))
    for part in sorted(part for part in parts if part.name not in _OTHERS):
        found.update(b"%s\0%s" % (part.name.encode(), part.read_bytes()))
    return found.hexdigest()


@cache
def load_library(path: Path = LIBRARY) -> ctypes.CDLL:
    """The library.

    Raises:
        LibraryError: it was not built, or is that of other equations.
    """
    try:
        library = ctypes.CDLL(str(path))
        made_from = ctypes.c_char_p.in_dll(library, "fingerprint").value
    except (OSError, ValueError):
        raise _unusable(path, "were not built for this machine") from None
    if made_from != fingerprint().encode():
        raise _unusable(path, "are older than the equations")
    return library


def _unusable(path: Path, why: str) -> LibraryError:
    command = "python -m steerd.car_model.native.build"
    return LibraryError(f"the compiled equations ({path}) {why}; build them with: {command}")


@cache
def load_function(label: str, name: str, level: str = "", path: Path = LIBRARY) -> Any:
    """A model's function for this processor, or for a level of one's own choice."""
    library: Any = load_library(path)
    if name in _SHORT:
        library = ctypes.PyDLL(str(path), handle=library._handle)  # noqa: SLF001
    function = getattr(library, f"{label}_{level or _level()}_{name}")
    function.argtypes = _ARGUMENTS[name]
    function.restype = c_int64 if name.endswith("constant_count") else None
    return function
