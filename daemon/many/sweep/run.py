"""`steerd.sweep`: many drives of the closed loop in virtual time, as a table and a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from steerd.car_model.model import believed_car
from steerd.car_model.path.path import locate, project
from steerd.controller.design import assess, delay_margin
from steerd.controller.loop_model import Timing
from steerd.daemon.analysis.options import CarSource, read_car
from steerd.daemon.analysis.simulation import plan_drive
from steerd.daemon.assembly.build import NS, RunPlan, make_world_config
from steerd.daemon.common.errors import SteerdError, UsageError
from steerd.daemon.common.notebook import speaking_of_arguments
from steerd.daemon.common.row_file import Row
from steerd.daemon.common.screen import shown
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.many.job import FAILED, Job, do_in_notebook
from steerd.daemon.many.sweep import plan as plans
from steerd.daemon.many.sweep.plan import DriveCase, Quantity, SweepPlan
from steerd.daemon.many.sweep.summary import Summary
from steerd.daemon.many.units import Done, Where
from steerd.daemon.offline.virtual import VirtualRun, drive, make_virtual_run
from steerd.daemon.sessions.motion import SETTLE, rms
from steerd.sim_hw.world import World, WorldConfig
from steerd.sysid.report.report import Report


@shown
@dataclass(frozen=True, eq=False)
class Sweep(Summary):
    """What a sweep found; `print(sweep)` is the screen of `steerd sweep`."""

    def make_report(self) -> Report:
        """What the page shows: distributions, stops, sensitivity of each to each."""
        from steerd.daemon.many.sweep.page import make_report

        return make_report(self)


@speaking_of_arguments
def sweep(
    vary: Mapping[str, Any],
    *,
    seeds: int | Sequence[int] = 100,
    car: CarSource = None,
    path: str = SweepPlan.path,
    speed: float = SweepPlan.speed,
    duration: float = SweepPlan.duration,
    rate: float = SweepPlan.rate,
    jobs: int = 0,
    output: Path | str | None = None,
) -> Sweep:
    """Drive the closed loop many times in virtual time, each time with another draw.

    Args:
        vary: by the quantity's name (`path`, `speed`, `car.mass`, `effect.steer_delay`,
            `mocap.position_noise`, …) a list, which is crossed with the other lists, or a
            distribution: `{"low": 1, "high": 2}`, `{"mean": 3, "sd": 0.2}`,
            `{"median": 0.01, "factor": 2}` or `{"share": 0.05}` of the car file's value.
        seeds: how many, or which; every combination of the lists is driven with each.
        car: what the controller is designed from, and the simulated car unless varied.
        path: of every drive, unless varied.
        speed: of every drive on straights [m/s], unless varied.
        duration: of a drive [s].
        rate: of the loop [Hz].
        jobs: worker processes; 0 for one per core.
        output: Parquet file to write. An interrupted sweep goes on where it was.

    Returns:
        The table, distributions, stops and sensitivities.

    Raises:
        SteerdError: a quantity or a value cannot be used.
    """
    given = {
        "seeds": seeds if isinstance(seeds, int) else list(seeds), "path": path, "speed": speed,
        "duration": duration, "rate": rate, "vary": vary,
    }  # fmt: skip
    job = make_job(plans.make_sweep_plan(read_car(car), given))
    return do_in_notebook(job, Where(jobs), output)


def make_job(plan: SweepPlan) -> Job[Sweep]:
    """A sweep as work for `do_job`; raises as `list_cases`."""
    cases = {str(case.number): case for case in plans.list_cases(plan)}

    def make_row(done: Done) -> Row:
        failed = {"outcome": FAILED, "reason": done.failure}
        case = cases[done.unit]
        return {"drive": case.number, "seed": case.seed, **case.values, **(done.row or failed)}

    work, make = partial(run_case, plan), partial(Sweep, plan=plan)
    return Job("driving", work, cases, plan.digest(), make_row, make)


def find_case(plan: SweepPlan, number: int) -> DriveCase:
    """One drive of a sweep, to be driven again alone.

    Raises:
        SteerdError: there is no such drive.
    """
    if not 0 <= number < plan.count:
        raise UsageError(f"there is no drive {number}: they are 0 to {plan.count - 1}")
    return next(islice(plans.list_cases(plan), number, None))


# -- one drive, in a worker: the whole closed loop in virtual time, to a row of numbers ------------


def run_case(plan: SweepPlan, case: DriveCase) -> dict[str, Any]:
    """Drive one case; its end and its measures, by column."""
    try:
        run_plan, config = prepare(plan, case)
        _ = run_plan.controller
    except SteerdError as error:
        return {"outcome": plans.REFUSED, "watchdog": "", "reason": error.what}
    ticks: list[tuple[float, ...]] = []

    def take(run: VirtualRun) -> None:
        result = run.core.last
        if result is not None and result.supervisor.state is SupervisorState.RUNNING:
            state, report = run.world.car.state, result.report
            found = (report.e1, report.e2, report.wheel) if report else (nan, nan, nan)
            ticks.append((run.t_ns / NS, state.x, state.y, state.yaw, state.speed, *found))

    run = make_virtual_run(run_plan, (), World(config))
    drive(run, take)
    row: dict[str, Any] = {"outcome": plans.DRIVEN, "watchdog": "", "reason": ""}
    loop = run.core.loop
    if loop.faulted or not loop.ran:
        waiting = run.core.last.waiting if run.core.last else ""
        reason = loop.fault or f"never driven: waiting for {waiting}"
        watchdog = reason.split()[0] if loop.faulted else ""
        row = {"outcome": plans.STOPPED, "watchdog": watchdog, "reason": reason}
    # How stable the designed gains hold the car that was drawn.
    believed, table = believed_car(config.model), run_plan.controller.table
    late = believed.steer_delay + believed.pose_delay
    timing = Timing(run_plan.options.rate_hz, late, believed.steer_lag)
    return row | judge_drive(run_plan, ticks) | {
        "damping": min(at.damping for at in assess(believed, table, timing)),
        "delay_margin": delay_margin(believed, table, timing),
    }  # fmt: skip


def prepare(plan: SweepPlan, case: DriveCase) -> tuple[RunPlan, WorldConfig]:
    """The drive's plan, and its simulated hardware.

    Raises:
        SteerdError: a path or a value cannot be used.
    """
    values = case.values
    speed, path = float(values.get("speed", plan.speed)), str(values.get("path", plan.path))
    numbers = {q: float(values[q.name]) for q in plan.quantities if not q.is_text}
    drawn = {q.fields[0]: value for q, value in numbers.items() if q.kind == "car"}
    effects: dict[str, dict[str, float]] = {}
    for q, value in numbers.items():
        if q.kind == "effect":
            effect, parameter = q.fields
            effects.setdefault(effect, {})[parameter] = value
    run_plan = plan_drive(plan.car, path, speed, plan.duration, case.seed, effects, rate=plan.rate)
    settings = run_plan.settings
    car = replace(settings.file, car=settings.file.car._replace(**drawn))
    run_plan = replace(run_plan, drawn=replace(settings, file=car))
    return run_plan, _vary_instruments(make_world_config(run_plan), numbers)


def _vary_instruments(config: WorldConfig, numbers: Mapping[Quantity, float]) -> WorldConfig:
    for q, value in numbers.items():
        if q.kind in ("mocap", "vesc"):
            device, (first, *others) = getattr(config, q.kind), q.fields
            if first.endswith("_ns"):
                value = max(round(value * NS) - sum(getattr(device, each) for each in others), 0)
            config = replace(config, **{q.kind: replace(device, **{first: value})})
    return config


def judge_drive(plan: RunPlan, ticks: Sequence[tuple[float, ...]]) -> dict[str, Any]:
    """The measures of `summary.MEASURES` that a drive itself gives; errors once it settled.

    Of each tick time [s], place [m, m, rad] and speed [m/s] of the simulated car, and as estimated
    the errors [m, rad] and the wheel's angle [rad].
    """
    rows, step = np.array(ticks).reshape(-1, 8), plan.period_ns / NS
    row: dict[str, Any] = {
        "seconds": step * len(rows), "metres": step * float(np.abs(rows[:, 4]).sum()),
    }  # fmt: skip
    rows = rows[(rows[:, 0] >= rows[:1, 0] + SETTLE) & np.isfinite(rows[:, 5])]
    if not len(rows):
        return row
    e1, e2, wheel = rows[:, 5:].T
    # Lateral error of the simulated car itself.
    hint, true = locate(plan.path, *rows[0, 1:4].tolist()).hint, []
    for x, y in rows[:, 1:3].tolist():
        place = project(plan.path, x, y, hint)
        hint = place.hint
        true.append(place.e1)
    true_e1, limits = np.array(true), plan.settings.limits
    most = np.where(wheel > 0.0, limits.steer_left_max, limits.steer_right_max)
    return row | {
        "e1_rms": rms(e1),
        "e1_p95": float(np.quantile(np.abs(e1), 0.95)),
        "e1_max": float(np.abs(e1).max()),
        "true_e1_rms": rms(true_e1),
        "true_e1_max": float(np.abs(true_e1).max()),
        "e2_rms": rms(e2),
        "lane_margin": plan.settings.thresholds.lateral - float(np.abs(e1).max()),
        "steer_margin": 1.0 - float((np.abs(wheel) / most).max()),
    }
