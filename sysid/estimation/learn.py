"""From drives to an outcome: fit by one of the methods, validate on what was held out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from steerd.car_model.model import Model
from steerd.car_model.params import Car
from steerd.sysid.data.data_checks import check_excited
from steerd.sysid.data.dataset import Run, check_sources
from steerd.sysid.data.excitation import measure_excitation, speed_tracking_share
from steerd.sysid.data.segments import describe_unused, hold_out, make_blocks, moving_segments
from steerd.sysid.estimation import outcome, validation
from steerd.sysid.estimation import preparation as prep
from steerd.sysid.estimation.command_timing import time_commands
from steerd.sysid.inference import constants as c
from steerd.sysid.inference import plain_car
from steerd.sysid.inference.car_fit import Stated, choose_start, fit_car
from steerd.sysid.inference.plain_car import Asked, PlainCar
from steerd.sysid.paper import SearchHistory
from steerd.sysid.parallel import map_jobs

TIMES: dict[str, float] = {
    "drive_delay": 1e-3, "steer_delay": 1e-3, "pose_delay": 1e-4, "steer_lag": 1e-4,
}  # fmt: skip
"""Doubts about times [s] that drives cannot remove: a command's stamp says when it left, not when
the motor controller took it over with its next tick, some 1 ms later; clocks of mocap and computer
agree to 0.1 ms; within a step of the grid the servo's motion is not known."""
OBEYED = 0.5  # a car that obeys its command less of the time is taken at its measured speed
REGIME = 1.0  # errors are split by lateral acceleration so far ahead [s]


@dataclass(frozen=True)
class Task:
    """What to learn of which drives."""

    runs: tuple[Run, ...]  # drives to fit
    model: Model[float]  # the car as believed so far
    asked: prep.FitOptions = field(default_factory=prep.FitOptions)
    held_out: tuple[Run, ...] = ()  # drives to validate with; empty holds out blocks of `runs`
    every: int = 4  # every k-th block of 5 s is held out
    free: tuple[str, ...] = ()  # names of the free parameters; empty for `default_free`
    held: tuple[str, ...] = ()  # parameters and effects that keep the model's values
    truth: Car[float] | None = None  # the simulated car, if it is known

    @property
    def question(self) -> Asked:
        """What is asked of the drives."""
        free = self.free or plain_car.default_free(self.model.chassis)
        return Asked(self.model, free, self.asked.wheelbase)

    @property
    def stated(self) -> Stated:
        """What whoever asks vouches for."""
        return Stated(self.asked.wheelbase is not None, self.held)

    @property
    def starts(self) -> int:
        """How many starts."""
        return self.asked.starts or (1 if self.asked.method == "ours" else 5)


def learn(task: Task, clock: Callable[[], float]) -> outcome.Outcome:
    """Identify a car; the `clock` [s] gives the outcome's `seconds`.

    Raises:
        DataError: the drives are not fit for it.
        ValueError: an option makes no sense.
        FloatingPointError: no start gives a finite simulation.
        ImportError: CMA-ES without Optuna.
    """
    check_sources((*task.runs, *task.held_out))
    began, given = clock(), task.model
    task, drives, roughs = _prepare(task)
    fit: outcome.Fit | None = None
    searches: tuple[SearchHistory, ...] = ()
    if task.asked.method == "ours":
        fit = _estimate(task, drives, roughs)
        after, known = fit.model, fit.estimates
        # End stops stay where they were as far as the drives allow.
        if after.car.steer_max != given.car.steer_max:
            after = after._replace(car=prep.restore_end_stops(after.car, given.car, task.runs))
    else:
        searches = _search(task)
        known = outcome.searched_estimates(searches)
        car = task.model.car._replace(**{name: e.value for name, e in known.items()})
        after = task.model._replace(car=car)
    seconds = clock() - began
    driven = (*task.runs, *task.held_out)
    horizons, cars = validation.HORIZONS, (after, task.model)
    traces = [validation.trace_windows(car, drives.held_out, max(horizons)) for car in cars]
    errors = [validation.errors_at(each, horizons) for each in traces]
    return outcome.Outcome(
        method=task.asked.method,
        sessions=tuple(dict.fromkeys(run.name for run in task.runs)),
        held_out_of=drives.held_out_of,
        before=task.model.car,
        after=after.car,
        rows=outcome.make_rows(given, after, known),
        held_out=tuple(outcome.HeldOut(a, b) for a, b in zip(*errors, strict=True)),
        excitation=measure_excitation(drives.moving),
        traces=(traces[0], traces[1]),
        fit=fit,
        searches=searches,
        seconds=seconds,
        notes=(*describe_unused(task.runs), *_notes(drives, fit)),
        truth=task.truth,
        pulses=tuple(run.pulse for run in driven if run.pulse),
        ramps=tuple(run.ramp for run in driven if run.ramp),
        log_jitters=tuple(run.log_jitter for run in driven if run.log_jitter),
        regimes=validation.by_lateral_acceleration(traces[0], REGIME),
    )


class _Drives(NamedTuple):
    """The drives as they are used."""

    moving: tuple[Run, ...]  # their segments in motion
    fitted: tuple[Run, ...]  # what is fitted
    held_out: tuple[Run, ...]  # what validates, and `held_out_of` in words
    held_out_of: str


def _prepare(task: Task) -> tuple[Task, _Drives, tuple[PlainCar, ...]]:
    """The task with drives as the car felt them, and rough cars of it, the best first."""
    roughs: tuple[PlainCar, ...] = ()
    if task.asked.method == "ours":
        task = _with_history(task)
        moving = moving_segments(task.runs)
        check_excited([run.commands[:, 0] for run in moving])
        roughs = _search_rough(task, moving)
        if roughs and any(run.servo_frame or run.speed_ramp for run in task.runs):
            asked = task.question._replace(free=plain_car.free_of(task.runs, task.question.free))
            timed = partial(time_commands, rough=roughs[0], asked=asked)
            runs, held_out = map(timed, task.runs), map(timed, task.held_out)
            task = replace(task, runs=tuple(runs), held_out=tuple(held_out))
    moving = moving_segments(task.runs)
    if task.held_out:
        words = ", ".join(run.name for run in task.held_out)
        split = make_blocks(moving), moving_segments(task.held_out), words
    else:
        words = f"every {task.every}th block of 5 s, not fitted"
        split = (*hold_out(moving, task.every), words)
    return task, _Drives(moving, *split), roughs


def _search_rough(task: Task, moving: Sequence[Run]) -> tuple[PlainCar, ...]:
    """Short searches from every start.

    At one speed a longer car that slides more and a servo that is later but quicker look much
    alike: there is a valley with more than one bottom, and errors at one know nothing of the other.
    """
    free, starts = task.question.free, _starts(task)
    if task.starts == 1 and prep.has_one_speed(moving):
        starts = [each for model in starts for each in prep.candidate_starts(model, free)]
    asked = task.question._replace(free=plain_car.free_of(moving, free))
    each = [asked._replace(model=model) for model in starts]
    found = map_jobs(partial(plain_car.search_plain, moving), each, task.asked.jobs)
    return tuple(sorted((rough for rough in found if rough), key=lambda rough: rough.point.cost))


def _starts(task: Task) -> list[Model[float]]:
    """Where searches begin: about the car as given, or of the drives' own size."""
    if task.starts > 1:
        return prep.scatter(task.model, task.question.free, task.starts, task.asked.seed)
    models = prep.possible_starts(task.model, task.runs, task.stated)
    return [prep.widen_end_stops(model, task.runs, task.question.free) for model in models]


def _estimate(task: Task, drives: _Drives, roughs: Sequence[PlainCar]) -> outcome.Fit:
    """The plain car where it leaves no more than noise, else a fit to windows of one second.

    Raises:
        FloatingPointError: no start gives a finite simulation.
        ValueError: no window sees enough poses.
    """
    plain = _fit_plain(task, drives, roughs) if roughs and roughs[0].explains else None
    if plain is not None and max(plain.misfit.values()) <= plain_car.POOR:
        return plain
    try:
        starts = _starts(task)
        if prep.slides(starts, drives.fitted, task.stated):  # a plain car's tyres never do
            starts = prep.sliding_starts(starts)
        elif roughs:
            starts = [roughs[0].start]
        start, near = choose_start(starts, drives.fitted, task.stated)
        fitted = fit_car(start, drives.fitted, task.stated, near)
        return outcome.fit_of_windows(fitted, start, drives.fitted, _doubts(drives))
    except (FloatingPointError, ValueError):
        if plain is None:
            raise
        return plain


def _fit_plain(task: Task, drives: _Drives, roughs: Sequence[PlainCar]) -> outcome.Fit | None:
    """The plain car over whole blocks; what ends that are as good place elsewhere is open."""
    runs, asked = drives.fitted, task.question
    able = asked._replace(free=plain_car.free_of(runs, asked.free))
    begun = roughs if prep.has_one_speed(runs) else roughs[:1]
    ends = [plain_car.search_plain(runs, able, rough) for rough in begun]
    if not (arrived := sorted((e for e in ends if e), key=lambda end: end.point.cost)):
        return None
    best, *others = arrived
    near = [e for e in others if e.point.cost - best.point.cost < c.RULED_OUT]
    doubts = _doubts(drives)
    found, *alike = (outcome.fit_of_plain(end, runs, asked, doubts) for end in (best, *near))
    estimates = prep.mark_ambiguous(found.estimates, [other.estimates for other in alike])
    return replace(found, estimates=estimates)


def _with_history(task: Task) -> Task:
    """The task with a past as long, and end stops as wide, as the drives need."""
    runs, held_out = (prep.add_command_history(e, task.model) for e in (task.runs, task.held_out))
    model = prep.widen_end_stops(task.model, runs, task.question.free)
    felt = "steer_rate" not in task.held and prep.exceeds_slew_rate(model, runs)
    free = dict.fromkeys((*task.question.free, *(["steer_rate"] if felt else [])))
    return replace(task, runs=runs, held_out=held_out, model=model, free=tuple(free))


def _doubts(drives: _Drives) -> tuple[tuple[str, float], ...]:
    """What no log says about times."""
    runs = (*drives.fitted, *drives.held_out)
    wait = max((run.pulse.blur for run in runs if run.pulse), default=0.0)
    return tuple({**TIMES, "steer_delay": float(np.hypot(TIMES["steer_delay"], wait))}.items())


def _search(task: Task) -> tuple[SearchHistory, ...]:
    """The paper's method or its baseline from random starts."""
    # torch: a second that our method need not wait
    from steerd.sysid.paper.paper_method import draw_starts, paper_runs, search_from

    asked = task.asked
    starts = draw_starts(np.random.default_rng(asked.seed), task.starts)
    work = partial(
        search_from, runs=paper_runs(task.runs), method=asked.method, iterations=asked.iterations
    )
    searches = map_jobs(work, list(enumerate(starts)), asked.jobs)
    if all(search.diverged for search in searches):
        raise FloatingPointError("the simulation diverges from every start")
    return tuple(searches)


def _notes(drives: _Drives, fit: outcome.Fit | None) -> tuple[str, ...]:
    notes, share = [], speed_tracking_share(drives.moving)
    if share < OBEYED:
        notes.append(
            f"the car went about as fast as it was asked in {share:.0%} of the time only: "
            "`--speed wheel` takes the measured speed instead"
        )
    if fit is None:
        return (*notes, "sd is the spread over the starts: this method has no error bars")
    if not fit.converged:
        notes.append("the search did not converge")
    poor = {group: ratio for group, ratio in fit.misfit.items() if ratio > plain_car.POOR}
    if poor:
        worst = max(poor, key=lambda group: poor[group])
        size = f"{poor[worst]:.{1 if poor[worst] < 10.0 else 0}f}"
        notes.append(
            f"residuals of {worst} are {size} times its noise: something is not in the "
            "model; `steerd diagnose` looks for it; the values come from windows of "
            f"{fit.horizon:.0f} s, weighed by the disturbances that show"
        )
    return (*notes, *fit.notes)
