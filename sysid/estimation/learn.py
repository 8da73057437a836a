"""From drives to an outcome: fit by one of the methods, validate on what was held out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import Car, wheelbase
from steerd.sysid.data.data_checks import check_excited
from steerd.sysid.data.dataset import Run, check_sources
from steerd.sysid.data.excitation import measure_excitation, speed_tracking_share
from steerd.sysid.data.segments import describe_unused, hold_out, make_blocks, moving_segments
from steerd.sysid.estimation.chart import SPREAD_RELATIVE
from steerd.sysid.estimation.fit import Fit, Options, default_free, fit
from steerd.sysid.estimation.multistart import (
    COMPARABLE,
    candidate_starts,
    has_one_speed,
    log_cost,
    mark_ambiguous,
)
from steerd.sysid.estimation.outcome import HeldOut, Outcome, Row
from steerd.sysid.estimation.outcome_rows import make_effect_rows, make_rows
from steerd.sysid.estimation.plain_start import possible_starts
from steerd.sysid.estimation.prediction_horizon import (
    ROUGH,
    SHORT,
    add_command_history,
    choose_horizons,
    exceeds_slew_rate,
    restore_end_stops,
    widen_end_stops,
)
from steerd.sysid.estimation.servo_pulse import Pulse, rough_fit, settle_servo
from steerd.sysid.estimation.setpoint_ramp import Ramp, settle_ramp
from steerd.sysid.estimation.taught import Stated, TaughtModel, Teacher, start_of, taught_rows
from steerd.sysid.estimation.validation import (
    HORIZONS,
    by_lateral_acceleration,
    errors_at,
    trace_windows,
)
from steerd.sysid.paper.search_history import NAMES, SearchHistory
from steerd.sysid.parallel import map_jobs

if TYPE_CHECKING:
    from steerd.sysid.paper.paper_method import PaperRun

Array = NDArray[np.float64]

METHODS: tuple[str, ...] = ("ours", "paper", "cma-es")
TIMES: dict[str, float] = {
    "drive_delay": 1e-3, "steer_delay": 1e-3, "pose_delay": 1e-4, "steer_lag": 1e-4,
}  # fmt: skip
"""Doubts about times [s] that drives cannot remove: a command's stamp says when it left, not when
the motor controller took it over with its next tick, some 1 ms later; clocks of mocap and computer
agree to 0.1 ms; within a step of the grid the servo's motion is not known."""
POOR = 2.0
"""Residuals so many times the noise say that the car is not explained, or another one is meant."""
OBEYED = 0.5
"""A car that obeys its speed command for less of the time is better taken at its measured speed."""
REGIME = 1.0
"""Errors are split by lateral acceleration so far ahead [s]."""
AGREE = 5e-4
"""Lengths that agree to this are the same measurement [m]."""
START_SPREAD = 0.3
"""Further starts lie about the first with this relative standard deviation."""


@dataclass(frozen=True)
class Task:
    """What to learn.

    Attributes:
        runs: drives to fit.
        held_out: drives to validate with; empty holds out blocks of `runs`.
        every: every k-th block of 5 s is held out.
        model: the car as believed so far.
        options: of our fit.
        method: one of `METHODS`.
        starts: how many starts.
        iterations: of the paper's methods; None for 100 (Adam), 500 (CMA-ES).
        seed: of the random starts.
        jobs, dask: where to work, see `scale.map_jobs`.
        truth: the simulated car, if it is known.
        held: parameters and effects that keep the model's values.
        teach: gives the values where residuals are many times the noise, see `taught`.
    """

    runs: tuple[Run, ...]
    model: Model[float]
    held_out: tuple[Run, ...] = ()
    every: int = 4
    options: Options = field(default_factory=Options)
    method: str = "ours"
    starts: int = 1
    iterations: int | None = None
    seed: int = 0
    jobs: int = 1
    dask: str | None = None
    truth: Car[float] | None = None
    held: tuple[str, ...] = ()
    teach: Teacher | None = None


def fit_wheelbase(
    model: Model[float], length: float | None, fixed: Sequence[str] = ()
) -> Model[float]:
    """The model with its axles at a known distance [m], in the same proportion.

    Of `fixed` lengths, one leaves the other to be what is missing; two are as they are.

    Raises:
        ValueError: fixed lengths and the distance do not agree.
    """
    if length is None:
        return model
    car = model.car
    if kept := [name for name in ("lf", "lr") if name in fixed]:
        other = length - getattr(car, kept[0])
        name = "lr" if kept[0] == "lf" else "lf"
        if other <= 0.0 or (len(kept) > 1 and abs(other - getattr(car, name)) > AGREE):
            lengths = " and ".join(f"{n} = {getattr(car, n):g}" for n in kept)
            raise ValueError(f"{lengths} do not make a wheelbase of {length:g} m")
        return model if len(kept) > 1 else model._replace(car=car._replace(**{name: other}))
    scale = length / wheelbase(model.car)
    return model._replace(car=model.car._replace(lf=model.car.lf * scale, lr=model.car.lr * scale))


def scatter(model: Model[float], free: Sequence[str], count: int, seed: int) -> list[Model[float]]:
    """The model and random ones about it; only lengths, stiffnesses and inertia move."""
    rng = np.random.default_rng(seed)
    moving = [n for n in free if n in ("lf", "lr", "c_sf", "c_sr", "inertia_z")]
    models = [model]
    for _ in range(count - 1):
        factors = np.exp(START_SPREAD * rng.standard_normal(len(moving))).tolist()
        moved = {n: getattr(model.car, n) * f for n, f in zip(moving, factors, strict=True)}
        models.append(model._replace(car=model.car._replace(**moved)))
    return models


def learn(task: Task, clock: Callable[[], float]) -> Outcome:
    """Identify a car.

    Args:
        task: what to learn from what.
        clock: seconds, for the outcome's `seconds`.

    Raises:
        DataError: the drives are not fit for it.
        ValueError: an option makes no sense.
        FloatingPointError: no start gives a finite simulation.
        BaselineMissingError: CMA-ES without Optuna.
    """
    check_sources((*task.runs, *task.held_out))
    began, given = clock(), task.model.car
    task, drives, rough = _prepare(task)
    task, found = _estimate(task, given, drives, rough)
    seconds = clock() - began
    after, rows, effect_rows = _fill_rows(task, given, found)
    traces = [trace_windows(each, drives.held_out, max(HORIZONS)) for each in (after, task.model)]
    errors = [errors_at(each, HORIZONS) for each in traces]
    return Outcome(
        method=task.method,
        sessions=tuple(dict.fromkeys(run.name for run in task.runs)),
        held_out_of=drives.held_out_of,
        before=task.model.car,
        after=after.car,
        rows=rows,
        combinations=found.fit.combinations if found.fit and found.taught is None else (),
        held_out=tuple(HeldOut(a, b) for a, b in zip(*errors, strict=True)),
        excitation=measure_excitation(drives.moving),
        traces=(traces[0], traces[1]),
        fit=found.fit,
        searches=found.searches,
        seconds=seconds,
        notes=(*describe_unused(task.runs), *_notes(task, drives, found)),
        truth=task.truth,
        pulses=drives.pulses,
        ramps=drives.ramps,
        effect_rows=effect_rows,
        log_jitters=tuple(run.log_jitter for run in (*task.runs, *task.held_out) if run.log_jitter),
        selected_effects=() if found.taught is None else found.taught.selected,
        regimes=by_lateral_acceleration(traces[0], REGIME),
        sections={} if found.taught is None else found.taught.sections,
    )


class _Drives(NamedTuple):
    """The drives as they are used.

    Attributes:
        moving: their segments in motion.
        fitted, held_out: what is fitted, and what validates; `held_out_of` says in words which.
        pulses, ramps: what was found out of the servo's and the motor controller's timing.
    """

    moving: tuple[Run, ...]
    fitted: tuple[Run, ...]
    held_out: tuple[Run, ...]
    held_out_of: str
    pulses: tuple[Pulse, ...]
    ramps: tuple[Ramp, ...]


class _Found(NamedTuple):
    """What the method found: a fit, or searches of the paper's methods.

    Attributes:
        taught: the car by the teacher, where its values are taken.
    """

    fit: Fit | None
    searches: tuple[SearchHistory, ...] = ()
    taught: TaughtModel | None = None


def _prepare(task: Task) -> tuple[Task, _Drives, Fit | None]:
    """The task with drives as the car felt them, and the rough fit that this needed, if any."""
    task, pulses, ramps, rough = _apply_timing(_with_history(task))
    task = replace(task, options=replace(task.options, doubts=_doubts(task, pulses)))
    moving = tuple(moving_segments(task.runs))
    return task, _Drives(moving, *_split(task, moving), pulses, ramps), rough


def _estimate(
    task: Task, given: Car[float], drives: _Drives, rough: Fit | None
) -> tuple[Task, _Found]:
    """The estimates by the task's method, and the task with windows as long as the car holds."""
    if task.method != "ours":
        return task, _Found(None, _search(task))
    if task.teach is not None and not _driven_by_steerd(task):
        return task, _Found(None, taught=_teach_foreign(task.teach, task, given, drives.fitted))
    if rough is None:
        options = replace(task.options, horizons=ROUGH)
        rough = fit(drives.fitted, task.model, options=options)
    task = replace(task, options=choose_horizons(task.options, rough))
    alone = _needs_teacher(task, rough) and not has_one_speed(drives.fitted)
    found = rough if alone else _fit_ours(task, drives.fitted)
    taught = _ask_teacher(task, given, found, drives.fitted)
    return task, _Found(found, taught=taught)


def _fill_rows(
    task: Task, given: Car[float], found: _Found
) -> tuple[Model[float], dict[str, Row], dict[str, Row]]:
    """The car after, and rows for its parameters and for those of its effects."""
    if found.taught is not None:
        return found.taught.model, *taught_rows(given, found.taught)
    car, rows = make_rows(task.model.car, given, task.runs, found.fit, found.searches)
    after = task.model._replace(car=car)
    if found.fit is not None:
        after = after._replace(values=found.fit.model.values)
    return after, rows, make_effect_rows(task.model, found.fit)


def _driven_by_steerd(task: Task) -> bool:
    """Whether servo or motor controller are known, as in sessions of one's own car."""
    return any(run.servo_frame or run.speed_ramp for run in task.runs)


def _teach_foreign(
    teach: Teacher, task: Task, given: Car[float], fitted: Sequence[Run]
) -> TaughtModel:
    """The car by the teacher from a start of the drives' own size: it may be any car.

    Raises:
        DataError: the steering is one constant throughout.
        FloatingPointError: no start gives a finite simulation.
        ValueError: no window sees enough poses.
    """
    check_excited([run.commands[:, 0] for run in fitted])
    stated = Stated(task.options.wheelbase is not None, task.held)
    starts = [
        widen_end_stops(model, task.runs, task.options.free or ())
        for model in possible_starts(task.model, task.runs, stated)
    ]
    taught = teach(starts, fitted, stated)
    car = restore_end_stops(taught.model.car, given, task.runs)
    return taught._replace(model=taught.model._replace(car=car))


def _ask_teacher(
    task: Task, given: Car[float], found: Fit | None, fitted: Sequence[Run]
) -> TaughtModel | None:
    """The car by the teacher, where the fit leaves more than noise."""
    if task.teach is None or found is None or not _needs_teacher(task, found):
        return None
    try:
        stated = Stated(task.options.wheelbase is not None, task.held)
        taught = task.teach((start_of(task.model, found),), fitted, stated)
    except (ValueError, FloatingPointError):
        return None
    car = taught.model.car
    if task.model.car.steer_max != given.steer_max:
        car = restore_end_stops(car, given, task.runs)
    return taught._replace(model=taught.model._replace(car=car))


def _needs_teacher(task: Task, found: Fit) -> bool:
    """Whether the values shall come from the teacher: then windows need not grow any longer."""
    poor = max(found.misfit.values(), default=0.0) > POOR
    return task.teach is not None and poor


def _split(task: Task, parts: Sequence[Run]) -> tuple[tuple[Run, ...], tuple[Run, ...], str]:
    """What is fitted, what is held out, and the latter in words."""
    if task.held_out:
        words = ", ".join(run.name for run in task.held_out)
        return make_blocks(parts), moving_segments(task.held_out), words
    return *hold_out(parts, task.every), f"every {task.every}th block of 5 s, not fitted"


def _with_history(task: Task) -> Task:
    """The task with a past as long, and end stops as wide, as the drives need."""
    if task.method != "ours":
        return task
    runs, held_out = (
        tuple(add_command_history(drives, task.model, task.teach is not None))
        for drives in (task.runs, task.held_out)
    )
    model = widen_end_stops(task.model, runs, task.options.free or ())
    return replace(task, runs=runs, held_out=held_out, model=model)


def _apply_timing(task: Task) -> tuple[Task, tuple[Pulse, ...], tuple[Ramp, ...], Fit | None]:
    """The task with commands as servos and motor controllers let them through.

    And the rough car that showed how, if one was needed. The paper's methods take commands as they
    are.
    """
    if task.method != "ours" or not _driven_by_steerd(task):
        return task, (), (), None
    rough = rough_fit(task.runs, task.model, task.options)
    settled: list[tuple[Run, ...]] = []
    pulses: list[Pulse] = []
    ramps: list[Ramp] = []
    for drives in (task.runs, task.held_out):
        limited, rates = settle_ramp(drives, rough, task.options)
        pulsed, phases = settle_servo(limited, rough, task.options)
        settled.append(pulsed)
        pulses += phases
        ramps += rates
    task = replace(task, runs=settled[0], held_out=settled[1])
    return task, tuple(pulses), tuple(ramps), rough


def _doubts(task: Task, pulses: Sequence[Pulse]) -> tuple[tuple[str, float], ...]:
    """What no log says about times, and the slew limit where it is felt and nobody measured it."""
    wait = max((pulse.blur for pulse in pulses), default=0.0)
    doubts = {**TIMES, "steer_delay": float(np.hypot(TIMES["steer_delay"], wait))}
    free = task.options.free or NAMES
    if "steer_rate" not in (*free, *task.held) and exceeds_slew_rate(task.model, task.runs):
        doubts["steer_rate"] = SPREAD_RELATIVE
    return (*task.options.doubts, *doubts.items())


def _fit_one(
    model: Model[float], runs: Sequence[Run], prior: Model[float], options: Options
) -> Fit:
    return fit(runs, prior, options=options, starts=[model])


def _fit_ours(task: Task, runs: Sequence[Run]) -> Fit:
    """The fit of lowest cost over the starts."""
    if task.starts <= 1 and not has_one_speed(runs):
        return fit(runs, task.model, options=task.options)
    if task.starts <= 1:
        return _fit_one_speed(task, runs)
    free = task.options.free or NAMES
    models = scatter(task.model, free, task.starts, task.seed)
    work = partial(_fit_one, runs=runs, prior=task.model, options=task.options)
    fits = map_jobs(work, models, task.jobs, task.dask)
    return min(fits, key=log_cost)


def _fit_one_speed(task: Task, runs: Sequence[Run]) -> Fit:
    """The best of a few starts; what moves between those as good as it is left open.

    At one speed a longer car that slides more and a servo that is later but quicker look much
    alike: there is a valley with more than one bottom, and errors at one know nothing of the other.
    """
    work = partial(_fit_one, runs=runs, prior=task.model, options=task.options)
    free = task.options.free or default_free(task.model.chassis)
    models = candidate_starts(task.model, free)
    fits = sorted(map_jobs(work, models, task.jobs, task.dask), key=log_cost)
    best, *others = fits
    return mark_ambiguous(best, [f for f in others if log_cost(f) - log_cost(best) < COMPARABLE])


def _search_from(
    item: tuple[int, Array], runs: "tuple[PaperRun, ...]", method: str, iterations: int | None
) -> SearchHistory:
    """One start. The problem is made where the work is done: compiled code does not travel."""
    number, start = item
    from steerd.sysid.paper.baselines import search_cma
    from steerd.sysid.paper.paper_method import make_problem, search_adam

    problem = make_problem(runs)
    if method == "paper":
        return search_adam(problem, start, iterations or 100)
    return search_cma(problem, start, iterations or 500, seed=number)


def _search(task: Task) -> tuple[SearchHistory, ...]:
    """The paper's method or its baseline from random starts."""
    from steerd.sysid.paper.paper_method import (  # torch: a second that our method need not wait
        draw_starts,
        paper_runs,
    )

    runs = paper_runs(task.runs)
    starts = draw_starts(np.random.default_rng(task.seed), max(task.starts, 1))
    work = partial(_search_from, runs=runs, method=task.method, iterations=task.iterations)
    searches = map_jobs(work, list(enumerate(starts)), task.jobs, task.dask)
    if all(search.diverged for search in searches):
        raise FloatingPointError("the simulation diverges from every start")
    return tuple(searches)


def _notes(task: Task, drives: _Drives, found: _Found) -> tuple[str, ...]:
    notes, share = [], speed_tracking_share(drives.moving)
    if share < OBEYED:
        notes.append(
            f"the car went about as fast as it was asked in {share:.0%} of the time only: "
            "`--speed wheel` takes the measured speed instead"
        )
    if found.fit is None and found.taught is not None:
        return (*notes, *found.taught.notes)
    if found.fit is None:
        return (*notes, "sd is the spread over the starts: this method has no error bars")
    if not found.fit.converged:
        notes.append("the last stage did not converge")
    if task.options.horizons == SHORT:
        notes.append(
            f"this model does not hold for longer: fitted over windows of {SHORT[-1]:g} s at most"
        )
    poor = {group: ratio for group, ratio in found.fit.misfit.items() if ratio > POOR}
    if poor:
        worst = max(poor, key=lambda group: poor[group])
        size = f"{poor[worst]:.{1 if poor[worst] < 10.0 else 0}f}"
        notes.append(
            f"residuals of {worst} are {size} times its noise: something is not in the "
            "model; `steerd diagnose` looks for it"
            + (
                "; the values come from windows of 1 s, weighed by the disturbances that show"
                if found.taught is not None
                else ", and values may be off by more than their sd"
            )
        )
    return tuple(notes)


def free_names(
    free: Sequence[str] | None,
    fixed: Sequence[str],
    default: Sequence[str],
    *,
    axles_known: bool = False,
) -> tuple[str, ...]:
    """Free parameters after `--free` and `--fix`.

    With the distance of the axles known, one fixed length leaves nothing of the other to learn.
    """
    known = {"lf", "lr"} if axles_known and {"lf", "lr"} & set(fixed) else set()
    return tuple(name for name in (free or default) if name not in known.union(fixed))


def held_names(
    fixed: Sequence[str],
    free: Sequence[str],
    *,
    axles_known: bool,
    effects: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """What keeps its value: what is fixed, and all else where `--free` names what does not.

    With the distance of the axles known, the other length follows from the one that is fixed or
    free. `effects` are the only ones that may be learnt; None leaves it to `free`.
    """
    axles = ("lf", "lr") if axles_known else ()
    kept = axles if set(axles) & set(fixed) else ()
    follows = axles if set(axles) & set(free) else ()
    moving = {*free, *follows, *(effects or ())}
    others = [name for name in Car._fields if name not in moving] if free else []
    if free or effects is not None:  # an effect may bear the name of the parameter that it moves
        others += [name for name in EFFECTS if name not in (*moving, *Car._fields)]
    return tuple(dict.fromkeys((*fixed, *kept, *others)))
