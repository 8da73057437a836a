"""`steerd.identify`: the car's parameters from recorded drives, with errors and a validation."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from steerd.car_model.car_file import CarFile, parse_car
from steerd.daemon.analysis.car_output import identified_values, make_car, with_knowledge
from steerd.daemon.analysis.drives import Speed, Warn
from steerd.daemon.analysis.identify_case import (
    IdentifyRequest,
    Method,
    given_values,
    make_task,
)
from steerd.daemon.analysis.sources import (
    CarSource,
    HeldOutSource,
    SessionSource,
    list_sessions,
    make_held_out,
    read_car,
)
from steerd.daemon.analysis.wiring import with_wiring
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.outputs import check_outputs
from steerd.daemon.common.written import write_outputs
from steerd.steer_bus.atomic_file import takes_nothing
from steerd.sysid.data.dataset import Run
from steerd.sysid.estimation.learn import Task
from steerd.sysid.estimation.outcome import Outcome, encode_outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIT_WORK = 2.0
"""About what the fit costs, in sessions read."""


class Parameter(NamedTuple):
    """One fitted parameter.

    Attributes:
        value: the estimate; sd: its standard error, NaN where there is none.
        unit: of both, SI; `1` for none.
        start: the value before.
        identifiable: whether these data identify it.
        manoeuvre: what would identify it; empty where it is identified.
    """

    value: float
    sd: float
    unit: str
    start: float
    identifiable: bool
    manoeuvre: str


@dataclass(frozen=True, eq=False)
class Identification:
    """What `identify` found.

    `print(identification)` is the screen of `steerd identify`.

    Attributes:
        request: what was asked for.
        outcome: every number of the fit and its validation.
        runs: the drives that were fitted.
        warnings: what is wrong or doubtful in the sessions.
    """

    request: IdentifyRequest
    outcome: Outcome
    runs: tuple[Run, ...]
    warnings: tuple[str, ...] = ()

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The fitted parameters by `name` or `effect.name`."""
        return {
            name: Parameter(
                row.value, float("nan") if row.sd is None else row.sd, row.unit, row.before,
                row.identifiable, row.manoeuvre,
            )
            for name, row in self.outcome.free_rows.items()
        }  # fmt: skip

    @property
    def improved(self) -> bool:
        """Whether the result predicts the held-out drives no worse than the start values."""
        from steerd.daemon.analysis.identify_text import improved

        return improved(self.outcome)

    @cached_property
    def car(self) -> CarFile:
        """The identified car, with the noise of its drives: a base for `diagnose`.

        Learning the noise takes some seconds, the first time.
        """
        text = self.make_car_text(Path("identified.toml"))
        return parse_car(text, Path("identified.toml"))

    def make_car_text(self, path: Path) -> str:
        """The car file of the identified car, comments and other sections as in the start's file.

        Where that is F1TENTH's, the other sections are those of the drives.

        Args:
            path: what messages call the file.

        Raises:
            SteerdError: a value is none that a car file may hold.
        """
        base, given = self.request.car, given_values(self.request.fix)
        car = make_car(base, identified_values(self.outcome, base, given), path)
        text = with_knowledge(car, self.runs, self.outcome.sections)
        return with_wiring(text, base, self.request.sessions)

    def save_car(self, path: Path | str) -> Path:
        """Write the car file, whole or not at all; a file that steerd did not write is kept.

        Raises:
            SteerdError: it cannot be written there.
        """
        path = Path(path)
        check_outputs({"save_car": path})
        write_outputs({path: self.car.text})
        return path

    def to_json(self) -> dict[str, Any]:
        """JSON values in the schema `steerd.identify/1`."""
        return encode_outcome(self.outcome)

    def render_report(self) -> str:
        """The report: one HTML page with its figures."""
        from steerd.sysid.report.identify_report import render_report

        return render_report(self.outcome)

    def plot(self) -> "Figure":
        """Held-out drives and their predictions, prediction errors, parameters with errors."""
        from steerd.daemon.analysis.figures import plot_identification

        return plot_identification(self.outcome)

    def __str__(self) -> str:
        from steerd.daemon.analysis.identify_text import describe

        return describe(self.outcome, axles_measured=self.request.wheelbase is not None)


def identify(
    sessions: SessionSource | Sequence[SessionSource],
    *,
    car: CarSource = None,
    held_out: HeldOutSource = None,
    effects: Sequence[str] | Literal["auto"] = (),
    free: Sequence[str] = (),
    fix: Mapping[str, float | None] | None = None,
    wheelbase: float | None = None,
    speed: Speed = "command",
    method: Method = "ours",
    starts: int | None = None,
    iterations: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    dask: str | None = None,
) -> Identification:
    """Identify a car from recorded drives.

    Args:
        sessions: drives to fit: files, or what `load` and `simulate` give.
        car: start values: a car file, an `Identification`; None for the F1TENTH car.
        held_out: what validates: every k-th block of 5 s (default 4), or whole sessions.
        effects: the only effects of the library that may be learnt with the car; empty or `auto`
            for all that the drives show (empty with `free`: none but those).
        free: parameters to fit; empty for all that the drives can hold.
        fix: parameters that keep the start value (None) or take this one, in SI units.
        wheelbase: measured distance of the axles [m].
        speed: `wheel` takes the measured wheel speed for the command, where a car did not obey it.
        method: `ours`, or the paper's `paper` and `cma-es`.
        starts: how many starts; None for 1 (ours) or 5.
        iterations: of the paper's methods; None for their own number.
        seed: of random starts.
        jobs: worker processes.
        dask: address of a Dask scheduler instead.

    Returns:
        Estimates, standard errors, validation.

    Raises:
        SteerdError: a session, the car or an argument cannot be used; `hint` says what to try.
    """
    request = IdentifyRequest(
        sessions=list_sessions(sessions),
        car=read_car(car),
        held_out=make_held_out(held_out),
        free=tuple(free),
        fix=dict(fix or {}),
        wheelbase=wheelbase,
        speed=speed,
        effects="auto" if effects == "auto" else tuple(effects),
        method=method,
        starts=starts,
        iterations=iterations,
        seed=seed,
        jobs=jobs,
        dask=dask,
    )
    return run_identification(request)


def run_identification(
    request: IdentifyRequest,
    warn: Warn = lambda texts: None,
    progress: Callable[[float, str], None] = lambda done, step: None,
) -> Identification:
    """Read the drives and fit.

    Args:
        request: what to identify.
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
    task = make_task(request, take)
    progress(float(len(request.sessions) + len(request.held_out.files)), "fitting the car")
    return Identification(request, _learn(task), task.runs, tuple(warnings))


def _learn(task: Task) -> Outcome:
    from steerd.sysid.data.data_checks import DataError
    from steerd.sysid.estimation.learn import learn
    from steerd.sysid.paper.search_history import BaselineMissingError
    from steerd.sysid.parallel import DaskMissingError

    try:
        return learn(task, time.perf_counter)
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None
    except (BaselineMissingError, DaskMissingError) as error:
        raise SteerdError(str(error), "", ExitCode.USAGE) from None
    except FloatingPointError as error:
        hint = "give start values closer to the car: --car FILE.toml, --wheelbase"
        raise SteerdError(str(error), hint, ExitCode.STOPPED) from None
    except (ValueError, OSError) as error:
        if takes_nothing(error):
            raise
        raise SteerdError(str(error), "", ExitCode.INVALID) from None
