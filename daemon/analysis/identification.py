"""`steerd.identify`: the car's parameters from recorded drives, with errors and a validation."""

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import CarFile, CarFileError, Learned, update_car
from steerd.car_model.params import Car
from steerd.daemon.analysis import car_output
from steerd.daemon.analysis import options as asked
from steerd.daemon.analysis.drives import Drives, load_drives, without_reserved
from steerd.daemon.assembly.sim_car import compare_truths, read_true_car
from steerd.daemon.common.errors import UsageError, refusing
from steerd.daemon.common.screen import shown
from steerd.sysid.estimation import preparation as prep
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import Outcome, Row, encode_outcome
from steerd.sysid.inference.plain_car import POOR, default_free
from steerd.sysid.report.report import Line, Report, finite

FIT = 2.0  # about what a fit costs, in sessions read
_LEAST = {"starts": 1, "iterations": 1, "jobs": 1, "seed": 0}
_WHEELBASE = 0.05, 4.0  # between a toy's and a lorry's wheelbase [m]; millimetres lie above


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(prep.FitOptions):
    """How to identify a car.

    Attributes:
        car: start values: a car file, an `Identification`; None for the F1TENTH car.
        held_out: what validates: every k-th block of 5 s (default 4), or whole sessions.
        speed: `wheel` takes the measured wheel speed for the command, where a car did not obey it.
    """

    car: asked.CarSource = None
    held_out: asked.HeldOutSource = None
    speed: asked.Speed = "command"


@shown
@dataclass(frozen=True, eq=False)
class Identification(asked.Finding):
    """What `identify` found.

    `print(identification)` is the screen of `steerd identify`.

    Attributes:
        options: what was asked for.
        base: the start values.
        drives: the sessions and the drives that were fitted.
        outcome: every number of the fit and its validation.
        warnings: what is wrong or doubtful in the sessions.
    """

    CAR = "identified.toml"
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
        """Whether the longest prediction of held-out drives became no worse (2 % are noise).

        By root mean square or by median: a few spins, which no model predicts, rule the former.
        """
        known = [h for h in self.outcome.held_out if not isnan(h.after.position)]
        return any(
            getattr(last.after, error) <= 1.02 * getattr(last.before, error)
            for last in known[-1:]
            for error in ("position", "median")
        )

    def make_car(self, path: Path) -> CarFile:
        """The identified car, comments and other sections as in the start's file.

        Where that is F1TENTH's, the other sections are those of the drives.
        """
        given = _given_values(self.options.fix)
        values = car_output.identified_values(self.outcome, self.base, given)
        wiring = car_output.find_wiring(self.base, self.drives.sessions)
        return car_output.make_car(self.base, values, path, wiring)

    def learn_known(self, car: CarFile) -> CarFile:
        """The car of `make_car` with its noise and covariance: some seconds."""
        fit = self.outcome.fit
        known = (fit and fit.sections) or car_output.learn_known(car, self.drives.runs)
        return car_output.with_known(car, known)

    def to_json(self) -> dict[str, Any]:
        """JSON values in the schema `steerd.identify/1`."""
        return dict(finite(encode_outcome(self.outcome)))

    def make_report(self, written: Path | None = None, report: Path | None = None) -> Report:
        """What screen, page and figure show; `written` is the car file that was written."""
        from steerd.daemon.analysis.identify_report import make_report

        return make_report(self.outcome, [*self._next(written)])

    def _next(self, written: Path | None) -> Iterator[Line]:
        outcome, drives = self.outcome, self.drives
        if any("`--speed wheel`" in note for note in outcome.notes):
            yield Line("next", "the same command with --speed wheel: these values explain a speed "
                       "that the car was not driven at; do not drive with them")  # fmt: skip
        elif not self.improved:
            why = "these values predict no better than the start; keep the old car file"
            poor = outcome.fit is None or max(outcome.fit.misfit.values(), default=0.0) > POOR
            yield Line("next", why)
            if poor and self.options.wheelbase is None:
                yield Line("", "measure the distance of the axles and give it as --wheelbase M: a "
                           "longer car, a smaller steering gain and a slower one are hard to "
                           "distinguish")  # fmt: skip
            elif not poor and outcome.unidentified:
                text = "the start explains these drives, and they are too gentle to improve it: "
                yield Line("", drives.complete(f"{text}drive `steerd collect --plan mixed`"))
        elif not any(row.identifiable for row in outcome.free_rows.values()):
            yield Line("next", "nothing is identifiable from these data; do not drive with these "
                       "values: keep the old car file, and do what the notes say")  # fmt: skip
        elif written is not None:
            yield Line("next", drives.simulate_with(written), whole=True)
            yield Line("", "(on the car: its --port and --mocap for --sim --fast)")
            command = f"steerd diagnose {drives.names} --base {shlex.quote(str(written))}"
            yield Line("", command, whole=True)
            yield Line("", "(what this model still misses)")
        else:
            yield Line("next", "repeat with -o car.toml, which writes a car file to drive with")


def run_identify(
    paths: Sequence[Path], options: IdentifyOptions, watch: asked.Watch
) -> Identification:
    """Identify a car from recorded drives: files, or what `load` and `simulate` give.

    Returns estimates, standard errors, validation. Raises a `SteerdError` where a session, the car
    or an argument cannot be used; its `hint` says what to try.
    """
    watch.progress(0.0, "reading the drives")
    base = asked.read_car(options.car)
    drives, task = _make_task(paths, options, base, watch)
    watch.progress(len(paths) / (len(paths) + FIT), "fitting the car")
    with drives.refusing("give start values closer to the car: --car FILE.toml, --wheelbase"):
        found = learn(task, time.perf_counter)
    # Commands that the result names run as they are printed.
    outcome = replace(
        found,
        rows={
            name: row._replace(manoeuvre=drives.complete(row.manoeuvre))
            for name, row in found.rows.items()
        },
        notes=tuple(drives.complete(note) for note in found.notes),
    )
    return Identification(options, base, drives, outcome, tuple(watch.warnings))


identify = asked.by_keywords("identifying", IdentifyOptions, run_identify)


def _make_task(
    paths: Sequence[Path], options: IdentifyOptions, base: CarFile, watch: asked.Watch
) -> tuple[Drives, Task]:
    """Read the drives and settle what is free; everything that can be refused is refused here."""
    held_out, length = asked.read_held_out(options.held_out), options.wheelbase
    for name, least in _LEAST.items():
        value = getattr(options, name)
        if value is not None and value < least:
            raise UsageError(f"{name} {value}: {least} or more")
    if held_out.every == 0:
        raise UsageError("held out 0: something must validate the fit", "2 or more")
    stated = {*options.free, *options.fix}
    effects = [f"{e.name}.{p.name}" for e in base.effects for p in e.parameters]
    for name in (*options.free, *options.fix):
        if name not in Car._fields and name not in effects:
            known = ", ".join((*Car._fields, *effects))
            raise UsageError(f"{name} is no parameter of the car", f"one of {known}")
    try:  # each stated value within what a car file may say
        given = _given_values(options.fix)
        model = update_car(base.path, base, given).model if given else base.model
    except CarFileError as error:
        raise UsageError(f"fix {error.where}: {error.what}", error.hint) from None
    if length is not None and not _WHEELBASE[0] <= length <= _WHEELBASE[1]:
        raise UsageError(f"wheelbase {length:g}: in metres")
    if options.effects != "auto":
        options = replace(options, effects=asked.read_effects(options.effects))
    with refusing(hint="fix one of lf and lr, or neither"):
        model = prep.fit_wheelbase(model, length, [*options.fix])
    if "inertia_z" not in stated:
        model = prep.scale_inertia(model, base.model)
    drives = load_drives(without_reserved(paths, held_out.files, "fit"), options.speed, watch)
    other = load_drives(held_out.files, options.speed, watch)
    if "cog_height" not in stated:
        model = prep.level_loads(model, drives.runs)
    different = compare_truths(drives.metadata | other.metadata)
    watch.warn(different)
    return drives, Task(
        drives.runs,
        model,
        options,
        held_out=other.runs,
        every=held_out.every or asked.EVERY,
        free=prep.free_names(options, default_free(model.chassis)),
        held=prep.held_names(options),
        truth=None if different else read_true_car(drives.sessions[0].info().metadata),
    )


def _given_values(fix: Mapping[str, float | None]) -> dict[str, Learned]:
    """What the user stated: the file that comes out is of that car."""
    stated = {name: value for name, value in fix.items() if value is not None}
    return {name: Learned(value, None, "given with --fix") for name, value in stated.items()}
