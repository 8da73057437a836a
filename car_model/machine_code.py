"""Recorded equations as C: printed once, compiled once per machine, loaded in milliseconds.

Whether the code is there never changes a number, only the time that it takes: products and sums are
not contracted, and it is used where the C library's functions give the bits that Python's give.
Where no compiler is found, or the code cannot be loaded, Python computes.
"""

# Why: docs/decisions/kernels.md#d84

import ctypes
import errno
import hashlib
import math
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import platformdirs

from steerd.car_model.params import Car
from steerd.car_model.straight_line import C_FORMS, FUNCTIONS, written
from steerd.car_model.tape import Node
from steerd.sealed_file import make_own_folder, read_sealed, seal

FLAGS = (
    "-O2", "-std=c11", "-fPIC", "-shared", "-ffp-contract=off",
    "-fno-builtin-sin", "-fno-builtin-cos",  # together they would become another function
)  # fmt: skip
_COMPILE_S = 60.0
"""Longest time that compiling is given [s]; it takes one."""
_READ = 0o644
"""A compiler's file may be written by whom the shell's mask lets."""
_ANGLES = tuple(0.37 * k + 0.01 for k in range(17))

_TRIED = "".join(f"    out[{i}] = {name}(a);\n" for i, name in enumerate(FUNCTIONS))
PRELUDE = f"""#include <math.h>

/* The functions that the equations call: whether they round as Python's is looked at on loading. */
void try_functions(double a, double *out)
{{
{_TRIED}}}
"""
"""What printed C begins with."""


class CodeNotKept(UserWarning):
    """Machine code cannot be kept on the disk: what it would do takes longer."""


class Source(NamedTuple):
    """C sources of one library, the first of them compiled."""

    name: str
    folder: Path
    files: tuple[str, ...]


def write_generated(target: Path, text: str) -> None:
    """Write a generated file and say so: what `python -m` of a generator does."""
    target.write_text(text, encoding="utf-8")
    sys.stdout.write(f"wrote {target.name}\n")


def printed_function(
    head: str, inputs: Sequence[Node], outputs: Sequence[Node], kind: str = "static void"
) -> str:
    """A C function `head(car, in, out)`; the car's parameters are recorded under their names."""
    statements, results = written(outputs, C_FORMS)
    words = set(re.findall(r"[a-z_0-9]+", " ".join([*statements, *results])))
    given = [(node.entry.name, f"in[{i}]") for i, node in enumerate(inputs)]
    given += [(field, f"car[{i}]") for i, field in enumerate(Car._fields)]
    lines = [
        "(void)car;",
        *(f"const double {field} = {source};" for field, source in given if field in words),
        *(f"const double {statement};" for statement in statements),
        *(f"out[{i}] = {result};" for i, result in enumerate(results)),
    ]
    arguments = "const double *car, const double *in, double *out"
    return f"\n{kind} {head}({arguments})\n{{\n" + "".join(f"    {e}\n" for e in lines) + "}\n"


def library_path(source: Source) -> Path:
    """Where the machine code lies, named after all that it is made from."""
    found = hashlib.sha256(
        " ".join(("sealed", platform.machine(), *platform.libc_ver(), *FLAGS)).encode()
    )
    for name in source.files:
        found.update((source.folder / name).read_bytes())
    folder = platformdirs.user_cache_path("steerd") / "machine-code"
    return folder / f"{source.name}_{found.hexdigest()[:24]}.so"


def find_compiler() -> list[str]:
    """The C compiler's command: `CC`, else the machine's; empty where there is none."""
    named = shlex.split(os.environ.get("CC", ""))
    found = shutil.which(named[0]) if named else None
    if found:
        return [found, *named[1:]]
    others = (shutil.which(name) for name in ("cc", "gcc", "clang"))
    return [other for other in others if other][:1]


def build_library(source: Source) -> Path | None:
    """The machine code, compiled unless it is there; None where that is not possible.

    Several processes may do so at once: each moves a whole file into place.
    """
    path, compiler = library_path(source), find_compiler()
    if read_sealed(path) is not None:
        return path
    if not compiler:
        return None
    try:
        make_own_folder(path.parent)
        with tempfile.TemporaryDirectory(prefix="build-", dir=path.parent) as folder:
            made = Path(folder) / path.name
            text = str(source.folder / source.files[0])
            command = [*compiler, *FLAGS, "-o", str(made), text, "-lm"]
            subprocess.run(command, check=True, capture_output=True, timeout=_COMPILE_S)
            with made.open("r+b") as file:
                file.write(seal(path.name, made.read_bytes()))
                file.flush()
                os.fsync(file.fileno())
            made.chmod(_READ)
            made.replace(path)
            return path
    except OSError as error:
        _report(path.parent, str(error.strerror))
    except subprocess.SubprocessError as error:
        full = os.strerror(errno.ENOSPC)
        if full.encode() in (getattr(error, "stderr", b"") or b""):
            _report(path.parent, full)
    return None


def _report(folder: Path, why: str) -> None:
    text = f"{folder}: {why}; without machine code, filter and simulated car are slower"
    warnings.warn(text, CodeNotKept, stacklevel=3)


def load_library(
    source: Source, check: Callable[[Any], bool] = lambda library: True
) -> ctypes.PyDLL | None:
    """The machine code where there is any, and it agrees with Python to the last bit.

    Its calls are short and keep the interpreter's lock, which another thread would not give back
    before some milliseconds.

    Args:
        source: of which library.
        check: whether what else it computes agrees.
    """
    try:
        path = library_path(source)
        if read_sealed(path) is None:
            return None
        library = ctypes.PyDLL(str(path))
        return library if same_functions(library) and check(library) else None
    except (OSError, AttributeError, KeyError):
        return None


def same_functions(library: Any) -> bool:
    """Whether its elementary functions round as Python's: Python may bring a C library."""
    out = (ctypes.c_double * len(FUNCTIONS))()
    for angle in _ANGLES:
        library.try_functions(ctypes.c_double(angle), out)
        if list(out) != [getattr(math, name)(angle) for name in FUNCTIONS]:
            return False
    return True
