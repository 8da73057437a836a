"""What is to be identified, checked: drives, what is held out, what is free and what is fixed."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from steerd.car_model.car_file import CarFile, CarFileError, Learned, parse_car, updated_text
from steerd.car_model.effects import EFFECTS, find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import Car
from steerd.daemon.analysis.drives import (
    Speed,
    Warn,
    load_drives,
    refuse_copies,
    without_reserved,
)
from steerd.daemon.analysis.held_out import EVERY, HeldOut
from steerd.daemon.assembly.sim_car import compare_truths, read_true_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.session_read import open_session
from steerd.sysid.estimation.learn import Task
from steerd.sysid.estimation.preparation import (
    fit_wheelbase,
    free_names,
    held_names,
    level_loads,
    scale_inertia,
)
from steerd.sysid.inference.plain_car import default_free

_USAGE = ExitCode.USAGE
_STARTS = {"ours": 1, "paper": 5, "cma-es": 5}
_LEAST = {"starts": 1, "iterations": 1, "jobs": 1, "seed": 0}
_WHEELBASE = 0.05, 4.0
"""Between a toy's and a lorry's wheelbase [m]; millimetres lie above."""

Method = Literal["ours", "paper", "cma-es"]


@dataclass(frozen=True, kw_only=True)
class IdentifyRequest:
    """What to identify, from which drives; see `identify` for what each means.

    Attributes:
        sessions: files of the drives.
        car: start values.
        held_out: what validates the result.
        free: parameters to fit; empty for all that the method fits.
        fix: parameters that keep the car's value (None) or take this one.
        wheelbase: measured distance of the axles [m].
        speed: `wheel` takes the measured speed in place of the command.
        effects: the only ones that may be learnt; empty or `auto` for all that drives show, empty
            with `free` for none but those.
        method, starts, iterations, seed: how to search.
        jobs, dask: where to work.
    """

    sessions: tuple[Path, ...]
    car: CarFile
    held_out: HeldOut = field(default_factory=HeldOut)
    free: tuple[str, ...] = ()
    fix: Mapping[str, float | None] = field(default_factory=lambda: MappingProxyType({}))
    wheelbase: float | None = None
    speed: Speed = "command"
    effects: tuple[str, ...] | Literal["auto"] = ()
    method: Method = "ours"
    starts: int | None = None
    iterations: int | None = None
    seed: int = 0
    jobs: int = 1
    dask: str | None = None


def make_task(request: IdentifyRequest, warn: Warn) -> Task:
    """Read the drives and settle what is free; everything that can be refused is refused here.

    Args:
        request: what to identify.
        warn: is handed what is doubtful in the sessions.

    Raises:
        SteerdError: a session or an option cannot be used.
    """
    base, fixed, free, length = request.car, [*request.fix], [*request.free], request.wheelbase
    _check_counts(request)
    _check_names((*free, *fixed), base.model)
    model = _with_fixed(base, request.fix).model
    if length is not None and not _WHEELBASE[0] <= length <= _WHEELBASE[1]:
        raise SteerdError(f"wheelbase {length:g}: in metres", "", _USAGE)
    candidates = _candidates(request)
    try:
        model = fit_wheelbase(model, length, fixed)
    except ValueError as error:
        raise SteerdError(str(error), "fix one of lf and lr, or neither", _USAGE) from None
    stated = {*free, *fixed}
    if "inertia_z" not in stated:
        model = scale_inertia(model, base.model)
    files = request.held_out.files
    refuse_copies(files)
    sessions = without_reserved(request.sessions, files, "fit")
    runs = tuple(load_drives(sessions, request.speed, warn))
    if "cog_height" not in stated:
        model = level_loads(model, runs)
    return Task(
        runs=runs,
        held_out=tuple(load_drives(files, request.speed, warn)),
        every=EVERY if request.held_out.every is None else request.held_out.every,
        model=model,
        free=free_names(free, fixed, default_free(model.chassis), axles_known=length is not None),
        wheelbase=length,
        method=request.method,
        starts=request.starts or _STARTS[request.method],
        iterations=request.iterations,
        seed=request.seed,
        jobs=request.jobs,
        dask=request.dask,
        truth=_truth(sessions, files, warn),
        held=held_names(fixed, free, axles_known=length is not None, effects=candidates),
    )


def _candidates(request: IdentifyRequest) -> tuple[str, ...] | None:
    """The only effects that may be learnt; None where `free` says what may be."""
    if request.effects == "auto":
        return tuple(EFFECTS)
    try:
        return tuple(find_effect(name).name for name in request.effects) or None
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint or "`steerd effects` lists them", _USAGE) from None


def _truth(sessions: Sequence[Path], held_out: Sequence[Path], warn: Warn) -> Car[float] | None:
    """The simulated car of sessions that were recorded in simulation; None if they differ."""
    metadata = {str(p.name): open_session(p).info().metadata for p in (*sessions, *held_out)}
    different = compare_truths(metadata)
    warn(different)
    return None if different else read_true_car(metadata[sessions[0].name])


def given_values(fix: Mapping[str, float | None]) -> dict[str, Learned]:
    """What the user stated: the file that comes out is of that car."""
    return {
        name: Learned(value, None, "given with --fix")
        for name, value in fix.items()
        if value is not None
    }


def _with_fixed(base: CarFile, fix: Mapping[str, float | None]) -> CarFile:
    """The car file with the stated values, each within what a car file may say."""
    for name, learned in given_values(fix).items():
        try:
            base = parse_car(updated_text(base, {name: learned}), base.path)
        except CarFileError as error:
            what = f"fix {name}={learned.value:g}: {error.what}"
            raise SteerdError(what, error.hint, _USAGE) from None
    return base


def _check_names(names: Iterable[str], model: Model[float]) -> None:
    effects = [f"{e.name}.{p.name}" for e in model.effects for p in e.parameters]
    for name in names:
        if name not in Car._fields and name not in effects:
            known = ", ".join((*Car._fields, *effects))
            raise SteerdError(f"{name} is no parameter of the car", f"one of {known}", _USAGE)


def _check_counts(request: IdentifyRequest) -> None:
    for name, least in _LEAST.items():
        value = getattr(request, name)
        if value is not None and value < least:
            raise SteerdError(f"{name} {value}: {least} or more", "", _USAGE)
    if request.held_out.every == 0:
        raise SteerdError("held out 0: something must validate the fit", "2 or more", _USAGE)
