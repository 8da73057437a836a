"""`steerd.sweep`: many drives of the closed loop in virtual time, as a table and a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steerd.daemon.analysis.options import CarSource, read_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.notebook import speaking_of_arguments
from steerd.daemon.common.row_file import Row
from steerd.daemon.common.screen import shown
from steerd.daemon.many.job import FAILED, Column, Found, Job, do_in_notebook
from steerd.daemon.many.sweep.drive import run_case
from steerd.daemon.many.sweep.plan import DriveCase, SweepPlan, list_cases, make_sweep_plan
from steerd.daemon.many.sweep.summary import Summary, describe_sweep, list_columns, summarise_sweep
from steerd.daemon.many.units import Done, Where

if TYPE_CHECKING:
    from steerd.sysid.report.report import Report


@shown
@dataclass(frozen=True, eq=False)
class Sweep(Found):
    """What a sweep found; `print(sweep)` is the screen of `steerd sweep`."""

    plan: SweepPlan  # what was driven

    @property
    def columns(self) -> Sequence[Column]:
        """The columns of the table with units and meanings."""
        return list_columns(self.plan.quantities)

    @cached_property
    def summary(self) -> Summary:
        """Distributions, stops, sensitivities."""
        return summarise_sweep(self.plan, self.rows)

    def make_report(self) -> "Report":
        """What the page shows: distributions, stops, sensitivity of each to each."""
        from steerd.daemon.many.sweep.page import make_report

        return make_report(self.plan, self.rows, self.summary)

    def __str__(self) -> str:
        mean = sum(row.get("seconds") or 0.0 for row in self.rows) / len(self.rows)
        speed = self.worked * mean / self.wall if self.worked and self.wall > 0.0 else None
        return describe_sweep(self.plan, self.rows, self.summary, speed)


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
    job = make_job(make_sweep_plan(read_car(car), given))
    return do_in_notebook(job, Where(jobs), output)


def make_job(plan: SweepPlan) -> Job[Sweep]:
    """A sweep as work for `do_job`.

    Raises:
        SteerdError: a distribution never yields what its quantity may be.
    """
    cases = {str(case.number): case for case in list_cases(plan)}

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
        what = f"there is no drive {number}: they are 0 to {plan.count - 1}"
        raise SteerdError(what, "", ExitCode.USAGE)
    return next(islice(list_cases(plan), number, None))
