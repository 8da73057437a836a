"""What `steerd identify` is asked, checked: drives, what is kept back, what is free and fixed."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from steerd.car_model.car_file import CarFile, CarFileError, Learned, parse_car, updated_text
from steerd.car_model.effects import find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import Car
from steerd.daemon.analysis.drives import load_drive, refuse_copies, without_reserved
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.session_read import open_session
from steerd.sysid.estimation.effect_selection import CANDIDATES
from steerd.sysid.estimation.fit import Options, default_free
from steerd.sysid.estimation.learn import Task, fit_wheelbase, free_names
from steerd.sysid.estimation.prediction_horizon import level_loads, scale_inertia

EVERY = 4
"""Unless said otherwise every 4th block is kept back."""
_USAGE = ExitCode.USAGE
_STARTS = {"ours": 1, "paper": 5, "cma-es": 5}
_LEAST = {"starts": 1, "iterations": 1, "jobs": 1, "seed": 0}


def parse_held_out(given: Sequence[str]) -> tuple[list[Path], int]:
    """Files, or the k of every k-th block.

    Raises:
        SteerdError: k makes no sense, or stands beside files.
    """
    numbers = [text for text in given if text.lstrip("-").isdigit()]
    if not numbers:
        return [Path(each) for each in given], EVERY
    if len(given) > 1:
        what = f"--held-out {numbers[0]}: every K-th block, or files, not both"
        raise SteerdError(what, "", _USAGE)
    if int(numbers[0]) < 2:
        raise SteerdError(f"--held-out {numbers[0]}: every K-th block, 2 or more", "", _USAGE)
    return [], int(numbers[0])


def make_task(args: argparse.Namespace, base: CarFile) -> Task:
    """Everything that is to be done, checked.

    Raises:
        SteerdError: a session or an option cannot be used.
    """
    _check_counts(args)
    fixed = parse_fix(args.fix)[0]
    free = [part for part in (args.free or "").split(",") if part]
    _check_names((*free, *fixed), base.model)
    model = _with_fixed(base, args.fix).model
    if args.wheelbase is not None and not 0.05 <= args.wheelbase <= 2.0:
        raise SteerdError(f"--wheelbase {args.wheelbase:g}: in metres", "", _USAGE)
    candidates = _candidates(args.effects)
    try:
        model = fit_wheelbase(model, args.wheelbase, fixed)
    except ValueError as error:
        raise SteerdError(str(error), "fix one of lf and lr, or neither", _USAGE) from None
    stated = {*free, *fixed}
    if "inertia_z" not in stated:
        model = scale_inertia(model, base.model)
    files, every = parse_held_out(args.held_out)
    refuse_copies(files)
    sessions = without_reserved(args.sessions, files, "fit")
    runs = tuple(load_drive(path, args.speed) for path in sessions)
    if "cog_height" not in stated:
        model = level_loads(model, runs)
    return Task(
        runs=runs,
        held_out=tuple(load_drive(path, args.speed) for path in files),
        every=every,
        model=model,
        options=Options(
            free=free_names(
                free, fixed, default_free(model.chassis), axles_known=args.wheelbase is not None
            ),
            wheelbase=args.wheelbase,
        ),
        method=args.method,
        starts=args.starts or _STARTS[args.method],
        iterations=args.iterations,
        seed=args.seed,
        jobs=args.jobs,
        dask=args.dask,
        truth=_truth(sessions[0]),
        effects=candidates,
        stated=tuple(fixed),
    )


def _candidates(given: str | None) -> tuple[str, ...]:
    """Effects to look for."""
    if given in (None, "", "auto"):
        return CANDIDATES if given == "auto" else ()
    try:
        return tuple(find_effect(name).name for name in str(given).split(",") if name)
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint or "`steerd effects` lists them", _USAGE) from None


def _truth(path: Path) -> Car[float] | None:
    """The simulated car of a session that was recorded in simulation."""
    metadata = open_session(path).info().metadata
    vehicle = metadata.get("steerd.vehicle", {})
    if metadata.get("steerd.session", {}).get("mode") != "sim":
        return None
    try:
        return Car(**{name: float(vehicle[name]) for name in Car._fields})
    except (KeyError, ValueError):
        return None


def parse_fix(text: str) -> tuple[list[str], dict[str, float]]:
    """Names to keep, and the values given for some of them."""
    names, values = [], {}
    for part in (p for p in text.split(",") if p):
        name, equals, number = part.partition("=")
        names.append(name)
        if equals:
            try:
                values[name] = float(number)
            except ValueError:
                raise SteerdError(f"--fix {part}: not a number", "", _USAGE) from None
    return names, values


def given_values(text: str) -> dict[str, Learned]:
    """What the user stated with --fix: the file that comes out is of that car.

    Raises:
        SteerdError: a value is no number.
    """
    return {name: Learned(v, None, "given with --fix") for name, v in parse_fix(text)[1].items()}


def _with_fixed(base: CarFile, text: str) -> CarFile:
    """The car file with the values of --fix, each within what a car file may say."""
    for name, learned in given_values(text).items():
        try:
            base = parse_car(updated_text(base, {name: learned}), base.path)
        except CarFileError as error:
            what = f"--fix {name}={learned.value:g}: {error.what}"
            raise SteerdError(what, error.hint, _USAGE) from None
    return base


def _check_names(names: Iterable[str], model: Model[float]) -> None:
    effects = [f"{e.name}.{p.name}" for e in model.effects for p in e.parameters]
    for name in names:
        if name not in Car._fields and name not in effects:
            known = ", ".join((*Car._fields, *effects))
            raise SteerdError(f"{name} is no parameter of the car", f"one of {known}", _USAGE)


def _check_counts(args: argparse.Namespace) -> None:
    for name, least in _LEAST.items():
        value = getattr(args, name)
        if value is not None and value < least:
            raise SteerdError(f"--{name} {value}: {least} or more", "", _USAGE)
