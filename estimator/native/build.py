"""The machine code of the filter, compiled once: `python -m steerd.estimator.native.build`.

Whether the code is there never changes a number, only the time that a tick takes: it is used where
it gives the very bits that Python gives, and that is looked at whenever it is loaded. Where no
compiler is found, or the code cannot be loaded, the Python filter drives.
"""

# Why: docs/decisions/kernels.md#d84

import contextlib
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import platformdirs

_HERE = Path(__file__).parent
SOURCES = ("filter.c", "equations.h")
FLAGS = (
    "-O2", "-std=c11", "-fPIC", "-shared", "-ffp-contract=off",
    "-fno-builtin-sin", "-fno-builtin-cos",  # together they would become another function
)  # fmt: skip
_COMPILE_S = 60.0
"""Longest time that compiling is given [s]; it takes one."""


def library_path() -> Path:
    """Where the machine code lies, named after all that it is made from."""
    found = hashlib.sha256(" ".join((platform.machine(), *platform.libc_ver(), *FLAGS)).encode())
    for name in SOURCES:
        found.update((_HERE / name).read_bytes())
    folder = platformdirs.user_cache_path("steerd") / "filter"
    return folder / f"filter_{found.hexdigest()[:24]}.so"


def find_compiler() -> list[str]:
    """The C compiler's command: `CC`, else the machine's; empty where there is none."""
    named = shlex.split(os.environ.get("CC", ""))
    found = shutil.which(named[0]) if named else None
    if found:
        return [found, *named[1:]]
    others = (shutil.which(name) for name in ("cc", "gcc", "clang"))
    return [other for other in others if other][:1]


def build_library() -> Path | None:
    """The machine code, compiled unless it is there; None where that is not possible.

    Several processes may do so at once: each moves a whole file into place.
    """
    path, compiler = library_path(), find_compiler()
    if path.exists() or not compiler:
        return path if path.exists() else None
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="build-", dir=path.parent) as folder:
            made = Path(folder) / path.name
            command = [*compiler, *FLAGS, "-o", str(made), str(_HERE / SOURCES[0]), "-lm"]
            subprocess.run(command, check=True, capture_output=True, timeout=_COMPILE_S)
            made.replace(path)
        return path
    return None


def main() -> None:
    """Compile what is not compiled yet, and say what the filter will run in."""
    made = build_library() is not None
    sys.stdout.write(f"the filter runs in {'machine code' if made else 'Python: no C compiler'}\n")


if __name__ == "__main__":
    main()
