"""An effect of one's own, in one file: checked, laid beside the library's, compiled with them.

Nothing reads such a file but the package itself: what simulates, identifies and names it is the
compiled library, which holds it from then on like any other effect.
"""

# Why: docs/decisions/vehicle-model.md#d120

import subprocess
import sys
from importlib import import_module
from math import sin
from pathlib import Path
from runpy import run_path

from steerd.car_model import effects
from steerd.car_model.effect import Effect
from steerd.car_model.model import Model, observe
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.rollout import simulate, start
from steerd.car_model.state import Command, State
from steerd.daemon.common.errors import SteerdError, UsageError
from steerd.daemon.common.written import write_whole

_FOLDER = Path(effects.__file__).parent
_BUILD = "steerd.car_model.native.build"
_STEPS, _STEP = 300, 0.01
"""The drive on which an effect at its null must change nothing: its steps and their length [s]."""


def add_effect(source: Path) -> tuple[str, ...]:
    """Build the library with the effects of a file, in place of one of that name; their names.

    A SteerdError where the file has none, one breaks the rules, or the library cannot be built,
    which then is as it was.
    """
    found = _read(source)
    for effect in found:
        _check(effect, source)
    target = _place(source)
    before = target.read_bytes() if target.exists() else None
    write_whole(target, source.read_bytes())
    _build_or_restore(target, before)
    return tuple(effect.name for effect in found)


def remove_effect(source: Path) -> tuple[str, ...]:
    """Build the library without the effects of a file of that name; none is added.

    A SteerdError where none was added, or the library cannot be built and is as it was.
    """
    target = _place(source)
    if not target.exists():
        added = ", ".join(p.name.removeprefix("own_") for p in _FOLDER.glob("own_*.py"))
        raise SteerdError(f"no effect was added from {source.name}", f"added: {added or 'none'}")
    before = target.read_bytes()
    target.unlink()
    _build_or_restore(target, before)
    return ()


def _place(source: Path) -> Path:
    return _FOLDER / f"own_{source.stem}.py"


def _read(source: Path) -> list[Effect]:
    if source.suffix != ".py":
        raise UsageError(f"{source} is no Python file", "name it my_effect.py")
    try:
        defined = run_path(str(source))
    except Exception as error:  # whatever somebody's own code raises
        raise SteerdError(f"{source}: {type(error).__name__}: {error}") from error
    found = [value for value in defined.values() if isinstance(value, Effect)]
    if not found:
        raise SteerdError(f"{source} defines no Effect", "EFFECT = Effect(name=…, …)")
    return found


def _check(effect: Effect, source: Path) -> None:
    """The name is free, and at its null the effect changes nothing, bit for bit."""
    before = _place(source)
    own = vars(import_module(f"{effects.__name__}.{before.stem}")) if before.exists() else {}
    if effects.EFFECTS.get(effect.name) not in (None, *own.values()):
        raise SteerdError(f"{source}: there is an effect {effect.name!r}", "give it another name")
    if _drive((effect,)) != _drive(()):
        what = f"{source}: {effect.name} changes the car at its null {effect.nulls}"
        raise SteerdError(what, "at the null a hook returns what it was given, bit for bit")


def _drive(chosen: tuple[Effect, ...]) -> list[tuple[float, ...]]:
    """Every state and observation of a lively drive."""
    model = Model(DEFAULT_CAR, chosen, tuple(effect.nulls for effect in chosen))
    first = start(model, State(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), 0.0)
    commands = [Command(0.3 * sin(0.05 * k), 1.5 + sin(0.02 * k)) for k in range(_STEPS)]
    moments = simulate(FLOAT, model, first, commands, _STEP)
    return [(*m.state, *observe(FLOAT, model, m.state)) for m in moments]


def _build_or_restore(target: Path, before: bytes | None) -> None:
    """Build in a process that sees the files as they are; where that fails, all is as it was."""
    here = _FOLDER.parents[2]  # of this installation, whatever lies in the user's own folder
    done = subprocess.run(
        [sys.executable, "-m", _BUILD], cwd=here, capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return
    if before is None:
        target.unlink()
    else:
        write_whole(target, before)
    lines = done.stderr.strip().splitlines() or ["it was ended"]
    raise SteerdError(f"the library cannot be built with it: {lines[-1]}", "pip install ziglang")
