"""`steerd.identify`: the car's parameters from recorded drives, with errors and a validation."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steerd.car_model.car_file import CarFile, CarFileError, Learned, update_car
from steerd.car_model.effects import EFFECTS, find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import Car
from steerd.daemon.analysis.car_output import (
    find_wiring,
    identified_values,
    learn_known,
    make_car,
    save_car,
    with_known,
)
from steerd.daemon.analysis.drives import Drives, Warn, load_drives, without_reserved
from steerd.daemon.analysis.hints import complete, refusing
from steerd.daemon.analysis.identify_text import Asked, describe
from steerd.daemon.analysis.options import (
    EVERY,
    IdentifyOptions,
    SessionSources,
    by_keywords,
    list_sessions,
    read_car,
    read_held_out,
)
from steerd.daemon.assembly.sim_car import compare_truths, read_true_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.notebook import notebook_progress
from steerd.daemon.common.screen import shown
from steerd.steer_bus.session_read import Session
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import Outcome, Row, encode_outcome
from steerd.sysid.estimation.preparation import (
    fit_wheelbase,
    free_names,
    held_names,
    level_loads,
    scale_inertia,
)
from steerd.sysid.inference.plain_car import default_free
from steerd.sysid.report.report import Card, finite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_USAGE = ExitCode.USAGE
_STARTS = {"ours": 1, "paper": 5, "cma-es": 5}
FIT = 2.0
"""About what a fit costs, in sessions read."""
_LEAST = {"starts": 1, "iterations": 1, "jobs": 1, "seed": 0}
_WHEELBASE = 0.05, 4.0
"""Between a toy's and a lorry's wheelbase [m]; millimetres lie above."""


@shown
@dataclass(frozen=True, eq=False)
class Identification:
    """What `identify` found.

    `print(identification)` is the screen of `steerd identify`.

    Attributes:
        options: what was asked for.
        base: the start values.
        drives: the sessions and the drives that were fitted.
        outcome: every number of the fit and its validation.
        warnings: what is wrong or doubtful in the sessions.
    """

    options: IdentifyOptions
    base: CarFile
    drives: Drives
    outcome: Outcome
    warnings: tuple[str, ...] = ()

    @property
    def parameters(self) -> dict[str, Row]:
        """The fitted parameters by `name` or `effect.name`, in SI units."""
        return self.outcome.free_rows

    @property
    def improved(self) -> bool:
        """Whether the longest prediction of held-out drives became no worse (2 % are noise)."""
        known = [h for h in self.outcome.held_out if not isnan(h.after.position)]
        return bool(known) and known[-1].after.position <= 1.02 * known[-1].before.position

    @property
    def cards(self) -> list[Card]:
        """The figures that the report shows first."""
        from steerd.sysid.report.identify_report import make_cards

        return list(make_cards(self.outcome))

    @cached_property
    def car(self) -> CarFile:
        """The identified car, with the noise of its drives: a base for `diagnose`.

        Learning the noise takes some seconds, the first time.
        """
        return self.learn_known(self.make_car(Path("identified.toml")))

    def save_car(self, path: Path | str) -> Path:
        """Write the car file and what is known of the car, see `save_car`."""
        return save_car(Path(path), self.make_car(Path(path)), self.car)

    def __str__(self) -> str:
        return self.describe()

    def make_car(self, path: Path) -> CarFile:
        """The identified car, comments and other sections as in the start's file.

        Where that is F1TENTH's, the other sections are those of the drives.
        """
        given = _given_values(self.options.fix)
        values = identified_values(self.outcome, self.base, given)
        return make_car(self.base, values, path, find_wiring(self.base, self.drives.sessions))

    def learn_known(self, car: CarFile) -> CarFile:
        """The car of `make_car` with its noise and covariance: some seconds."""
        return with_known(car, self.outcome.sections or learn_known(car, self.drives.runs))

    def to_json(self) -> dict[str, Any]:
        """JSON values in the schema `steerd.identify/1`."""
        return dict(finite(encode_outcome(self.outcome)))

    def render_report(self) -> str:
        """The report."""
        from steerd.sysid.report.identify_report import make_report
        from steerd.sysid.report.page import render_report

        return render_report(make_report(self.outcome))

    def plot(self) -> "Figure":
        """Held-out drives and their predictions, prediction errors, parameters with errors."""
        from steerd.daemon.analysis.figures import plot_identification

        return plot_identification(self.outcome)

    def describe(self, written: Path | None = None, report: Path | None = None) -> str:
        """The screen; `written` is the car file that was written."""
        measured = self.options.wheelbase is not None
        return describe(self.outcome, Asked(self.drives.sessions, self.improved, measured, written))


@by_keywords(IdentifyOptions)
def identify(sessions: SessionSources, options: IdentifyOptions) -> Identification:
    """Identify a car from recorded drives: files, or what `load` and `simulate` give.

    Returns estimates, standard errors, validation. Raises a `SteerdError` where a session, the car
    or an argument cannot be used; its `hint` says what to try.
    """
    paths = list_sessions(sessions)
    with notebook_progress("identifying", len(paths) + FIT) as progress:
        return run_identification(paths, options, progress=progress)


def run_identification(
    paths: Sequence[Path],
    options: IdentifyOptions,
    warn: Warn = lambda texts: None,
    progress: Callable[[float, str], None] = lambda done, step: None,
) -> Identification:
    """Read the drives and fit.

    Args:
        paths: the sessions.
        options: what to identify.
        warn: is handed what is doubtful in the sessions as it is found.
        progress: is called with the work done, in sessions read, and the next step.

    Raises:
        SteerdError: as `identify`.
    """
    warnings: list[str] = []

    def take(texts: Sequence[str]) -> None:
        warnings.extend(texts)
        warn(texts)

    progress(0.0, "reading the drives")
    base = read_car(options.car)
    drives, task = _make_task(paths, options, base, take)
    progress(float(len(paths)), "fitting the car")
    closer = "give start values closer to the car: --car FILE.toml, --wheelbase"
    with refusing(drives.sessions, closer):
        outcome = _completed(learn(task, time.perf_counter), drives.sessions)
    return Identification(options, base, drives, outcome, tuple(warnings))


def _completed(outcome: Outcome, sessions: Sequence[Session]) -> Outcome:
    """The outcome with commands that run as printed."""
    rows, effect_rows = (
        {n: r._replace(manoeuvre=complete(r.manoeuvre, sessions)) for n, r in named.items()}
        for named in (outcome.rows, outcome.effect_rows)
    )
    notes = tuple(complete(note, sessions) for note in outcome.notes)
    return replace(outcome, rows=rows, effect_rows=effect_rows, notes=notes)


def _make_task(
    paths: Sequence[Path], options: IdentifyOptions, base: CarFile, warn: Warn
) -> tuple[Drives, Task]:
    """Read the drives and settle what is free; everything that can be refused is refused here.

    Raises:
        SteerdError: a session or an option cannot be used.
    """
    fixed, free, length = [*options.fix], [*options.free], options.wheelbase
    held_out = read_held_out(options.held_out)
    _check_counts(options, held_out.every)
    _check_names((*free, *fixed), base.model)
    model = _with_fixed(base, _given_values(options.fix))
    if length is not None and not _WHEELBASE[0] <= length <= _WHEELBASE[1]:
        raise SteerdError(f"wheelbase {length:g}: in metres", "", _USAGE)
    auto = options.effects == "auto"
    candidates = tuple(EFFECTS) if auto else find_effects(options.effects) or None
    try:
        model = fit_wheelbase(model, length, fixed)
    except ValueError as error:
        raise SteerdError(str(error), "fix one of lf and lr, or neither", _USAGE) from None
    stated = {*free, *fixed}
    if "inertia_z" not in stated:
        model = scale_inertia(model, base.model)
    sessions = without_reserved(paths, held_out.files, "fit")
    drives = load_drives(sessions, options.speed, warn)
    other = load_drives(held_out.files, options.speed, warn)
    if "cog_height" not in stated:
        model = level_loads(model, drives.runs)
    different = compare_truths(drives.metadata | other.metadata)
    warn(different)
    first = drives.sessions[0].info().metadata
    return drives, Task(
        runs=drives.runs,
        held_out=other.runs,
        every=EVERY if held_out.every is None else held_out.every,
        model=model,
        free=free_names(free, fixed, default_free(model.chassis), axles_known=length is not None),
        wheelbase=length,
        method=options.method,
        starts=options.starts or _STARTS[options.method],
        iterations=options.iterations,
        seed=options.seed,
        jobs=options.jobs,
        dask=options.dask,
        truth=None if different else read_true_car(first),
        held=held_names(fixed, free, axles_known=length is not None, effects=candidates),
    )


def find_effects(names: Iterable[str]) -> tuple[str, ...]:
    """Effects by their own names.

    Raises:
        SteerdError: there is none of a name.
    """
    try:
        return tuple(find_effect(name).name for name in names)
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint or "`steerd effects` lists them", _USAGE) from None


def _given_values(fix: Mapping[str, float | None]) -> dict[str, Learned]:
    """What the user stated: the file that comes out is of that car."""
    stated = {name: value for name, value in fix.items() if value is not None}
    return {name: Learned(value, None, "given with --fix") for name, value in stated.items()}


def _with_fixed(base: CarFile, given: Mapping[str, Learned]) -> Model[float]:
    """The car with the stated values, each within what a car file may say."""
    try:
        return update_car(base.path, base, given).model if given else base.model
    except CarFileError as error:
        raise SteerdError(f"fix {error.where}: {error.what}", error.hint, _USAGE) from None


def _check_names(names: Iterable[str], model: Model[float]) -> None:
    effects = [f"{e.name}.{p.name}" for e in model.effects for p in e.parameters]
    for name in names:
        if name not in Car._fields and name not in effects:
            known = ", ".join((*Car._fields, *effects))
            raise SteerdError(f"{name} is no parameter of the car", f"one of {known}", _USAGE)


def _check_counts(options: IdentifyOptions, every: int | None) -> None:
    for name, least in _LEAST.items():
        value = getattr(options, name)
        if value is not None and value < least:
            raise SteerdError(f"{name} {value}: {least} or more", "", _USAGE)
    if every == 0:
        raise SteerdError("held out 0: something must validate the fit", "2 or more", _USAGE)
