"""Print the equations as C and compile the library: `python -m steerd.car_model.native.build`.

The package's build hook (`hatch_build.py`) does this too, so nobody compiles at run time. The
compiler is `ziglang`, a build requirement that pip installs (clang with its own C library); where
it is not installed, the C compiler of the machine serves (`CC`). Each model is compiled for
each processor level; all give the same bits.
"""

import importlib.util
import os
import platform
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.effects import EFFECTS
from steerd.car_model.native.library import LEVELS, LIBRARY, fingerprint, model_label
from steerd.car_model.native.print_c import print_filter, print_model
from steerd.car_model.native.trace import trace
from steerd.car_model.planar import CHASSIS

HERE = Path(__file__).parent
OPTIONS = (
    "-std=gnu11", "-O2", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math",
    "-w", "-g0",
)  # fmt: skip
"""Nothing may be contracted to FMA: the same bits from every compiler on every processor."""

OLDEST_LIBC = "2.28"
"""The GNU C library that suffices, where ziglang compiles: what the wheel's name says."""


class Compiler(NamedTuple):
    """A C compiler and how it calls the processor levels."""

    command: tuple[str, ...]  # the program and what it always needs
    level: str  # option that chooses a level, `{}` for its name; names with `_` instead of `-`
    underscores: bool  # whether names of levels have underscores


class BuildError(Exception):
    """The library cannot be built; the message says why and what to try."""


def find_compiler() -> Compiler:
    """The compiler that the environment names (`CC`), or ziglang, or the machine's own."""
    if "CC" not in os.environ and importlib.util.find_spec("ziglang"):
        target = f"-target {platform.machine()}-linux-gnu.{OLDEST_LIBC}".split()
        command = (sys.executable, "-m", "ziglang", "cc", *target, "-fno-sanitize=all")
        return Compiler(command, "-mcpu={}", underscores=True)
    return Compiler(tuple(shlex.split(os.environ.get("CC", "cc"))), "-march={}", underscores=False)


def wheel_tag(compiler: Compiler) -> str:
    """What a wheel with the library is called."""
    libc = f"many{platform.system()}_{OLDEST_LIBC}" if compiler.underscores else platform.system()
    return f"py3-none-{libc}_{platform.machine()}".lower().replace(".", "_")


def models() -> Iterator[tuple[tuple[Effect, ...], Chassis]]:
    """What the library holds: each chassis without effects and with every one."""
    for effects in ((), tuple(EFFECTS.values())):
        for chassis in CHASSIS:
            yield effects, chassis


def model_text(effects: tuple[Effect, ...], chassis: Chassis) -> str:
    """The C file of one model; `EXPORT(name)` is what its functions are called."""
    pieces = print_model(trace(effects, chassis), "car")
    text = f'#include "vectors.h"\n{pieces}\n#include "march.h"\n'
    return text if effects else f'{text}{print_filter(chassis)}\n#include "filter.h"\n'


def _run(command: Sequence[str]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(
            f"no C compiler: {command[0]}: {error.strerror}; install one with: pip install ziglang"
        ) from None
    if done.returncode:
        raise BuildError(f"{shlex.join(command[:4])} … failed:\n{done.stderr[-4000:]}")


def compile_model(
    compiler: Compiler, source: Path, label: str, level: str, name: str, *more: str
) -> Path:
    """Compile one model for a processor level.

    Args:
        compiler: by which.
        source: the model's C file; the object file is written beside it.
        label: what its functions begin with.
        level: what follows; see `LEVELS`.
        name: the compilers' name of it, none for their default.
        more: further options.

    Raises:
        BuildError: the compiler fails.
    """
    target = source.with_name(f"{label}_{level}.o")
    own = name.replace("-", "_") if compiler.underscores else name
    chosen = [compiler.level.format(own)] if own else []
    export = f"-DEXPORT(name)={label}_{level}_##name"
    command = [*compiler.command, *OPTIONS, *chosen, *more, export, f"-I{HERE}"]
    _run([*command, "-c", str(source), "-o", str(target)])
    return target


def link(compiler: Compiler, objects: Sequence[Path], target: Path) -> None:
    """Make a library of object files; one that a process has loaded keeps its file.

    Raises:
        BuildError: the compiler fails.
    """
    made, mark = target.with_name(f"{target.name}.new"), objects[0].with_name("fingerprint.c")
    mark.write_text(f'const char *const fingerprint = "{fingerprint()}";\n', encoding="ascii")
    files = map(str, (mark, *objects))
    _run([*compiler.command, *OPTIONS, "-shared", "-s", *files, "-lm", "-o", str(made)])
    made.replace(target)


def build(target: Path = LIBRARY, compiler: Compiler | None = None) -> Path:
    """Print and compile the library.

    Args:
        target: the file to write.
        compiler: one of one's own choice.

    Raises:
        BuildError: there is no compiler, or it fails.
    """
    compiler = compiler or find_compiler()
    levels = LEVELS.get(platform.machine(), {"plain": ""})
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = []
        for effects, chassis in models():
            label = model_label(effects, chassis)
            source = Path(folder) / f"{label}.c"
            source.write_text(model_text(effects, chassis), encoding="ascii")
            for level, options in levels.items():
                jobs.append(pool.submit(compile_model, compiler, source, label, level, options))
        link(compiler, [job.result() for job in jobs], target)
    return target


if __name__ == "__main__":
    try:
        build()
    except BuildError as error:
        sys.exit(str(error))
