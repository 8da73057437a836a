"""`steerd.diagnose`: where simulation and car differ, why, and how far adding the cause helps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steerd.car_model.car_file import CarFile
from steerd.daemon.analysis.car_output import diagnosed_values, make_car
from steerd.daemon.analysis.diagnose_case import Case, DiagnoseRequest, make_case
from steerd.daemon.analysis.drives import Speed, Warn
from steerd.daemon.analysis.sources import (
    CarSource,
    HeldOutSource,
    SessionSource,
    list_sessions,
    make_held_out,
    read_car,
)
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.outputs import check_outputs
from steerd.daemon.common.written import write_outputs
from steerd.sim_gap.diagnosis import Diagnosis as Findings
from steerd.sim_gap.lane_comparison import LaneComparison
from steerd.sim_gap.verdict.evidence import Cause
from steerd.steer_bus.atomic_file import takes_nothing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOADED, DIAGNOSED, DRIVEN = 0.05, 0.85, 0.95
"""Shares of the work done after loading, after the diagnosis, after the closed loop."""
_IDENTIFY = "a base identified from such drives: steerd identify … -o car.toml, --base car.toml"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `diagnose` found.

    `print(diagnosis)` is the screen of `steerd diagnose`.

    Attributes:
        case: drives, base car and what was held out.
        findings: every number of the diagnosis.
        lane: the session's lane driven again in simulation; None if that was not possible.
        lane_note: why not; empty if it was, or was not asked for.
        warnings: what is wrong or doubtful in the sessions.
    """

    case: Case
    findings: Findings
    lane: LaneComparison | None
    lane_note: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """`none`, `explained`, `partial`, `unexplained` or `unjudged`."""
        return self.findings.verdict

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Named effects with parameters (value, standard error, unit) and confidence (0 to 1)."""
        return self.findings.causes

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know about data and method."""
        lane = (self.lane_note,) if self.lane_note else ()
        return (*self.case.notes, *self.findings.notes, *lane)

    @cached_property
    def car(self) -> CarFile:
        """The base with the found effects: simulate with it, or design from it."""
        return self.make_car(Path("diagnosed.toml"))

    def make_car(self, path: Path) -> CarFile:
        """The base with the found effects.

        Args:
            path: what messages call its file.

        Raises:
            SteerdError: a value is none that a car file may hold.
        """
        return make_car(
            self.case.base, diagnosed_values(self.findings.causes, self.case.sessions), path
        )

    def save_car(self, path: Path | str) -> Path:
        """Write the car file of `car`, whole or not at all.

        Raises:
            SteerdError: it cannot be written there.
        """
        path = Path(path)
        check_outputs({"save_car": path})
        write_outputs({path: self.make_car(path).text})
        return path

    def to_json(self) -> dict[str, Any]:
        """JSON values in the schema `steerd.gap/1`; what they rest on is under `residual`."""
        from steerd.sim_gap.lane_comparison import encode_lane
        from steerd.sim_gap.report.to_json import to_json

        data = to_json(self.findings)
        residual = data["residual"]
        residual["sessions"] = [path.name for path in self.case.sessions]
        residual["base"] = self.case.base_source
        residual["held_out_of"] = self.case.held_out_of or None
        residual["prediction"] = self.findings.shrinkage.text
        lane_note = [self.lane_note] if self.lane_note else []
        residual["notes"] = [*self.case.notes, *residual["notes"], *lane_note]
        residual["closed_loop"] = None if self.lane is None else encode_lane(self.lane)
        return data

    def render_report(self) -> str:
        """The report: one HTML page with its figures."""
        from steerd.sim_gap.report.gap_report import Subject, render_report

        case, lane_note = self.case, (self.lane_note,) if self.lane_note else ()
        names, notes = tuple(path.name for path in case.sessions), (*case.notes, *lane_note)
        subject = Subject(names, case.seconds, case.base_source, case.held_out_of, notes)
        return render_report(subject, self.findings, self.lane)

    def plot(self) -> "Figure":
        """Prediction errors before and after, candidate effects, the gap over time."""
        from steerd.daemon.analysis.figures import plot_diagnosis

        return plot_diagnosis(self.findings)

    def __str__(self) -> str:
        from steerd.daemon.analysis.diagnose_text import describe

        return describe(self)


def diagnose(
    sessions: SessionSource | Sequence[SessionSource],
    *,
    base: CarSource = None,
    healthy: SessionSource | Sequence[SessionSource] = (),
    held_out: HeldOutSource = None,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
    pairs: bool = True,
    closed_loop: bool = True,
    speed: Speed = "command",
    jobs: int = 1,
) -> Diagnosis:
    """Find where the simulation of a car differs from its drives, and which effect causes it.

    Args:
        sessions: drives to explain: files, or what `load` and `simulate` give.
        base: the car as believed: a car file, an `Identification`; None for the car file inside
            the first session.
        healthy: drives of the same car without the gap: they determine how large noise is.
        held_out: what the shrinkage is measured on: every k-th drive or block (default 4, 0 for
            none), or whole sessions.
        only: effects to look at; empty for the library.
        without: effects to leave out.
        pairs: whether two causes together are tried.
        closed_loop: whether a lane drive is driven again in simulation, with and without.
        speed: `wheel` takes the measured wheel speed for the command, where a car did not obey it.
        jobs: threads for the candidates.

    Returns:
        Verdict, causes with standard errors, predicted and measured shrinkage.

    Raises:
        SteerdError: a session, the car or an argument cannot be used; `hint` says what to try.
    """
    request = DiagnoseRequest(
        sessions=list_sessions(sessions),
        base=None if base is None else read_car(base),
        held_out=make_held_out(held_out),
        healthy=list_sessions(healthy),
        only=tuple(only),
        without=tuple(without),
        pairs=pairs,
        closed_loop=closed_loop,
        speed=speed,
        jobs=jobs,
    )
    return run_diagnosis(request)


def run_diagnosis(
    request: DiagnoseRequest,
    warn: Warn = lambda texts: None,
    progress: Callable[[float, str], None] = lambda done, step: None,
    written: Callable[[str], None] = lambda prediction: None,
) -> Diagnosis:
    """Read the drives, diagnose, drive the lane again.

    Args:
        request: what to diagnose.
        warn: is handed what is doubtful in the sessions as it is found.
        progress: is called with the share of the work done and the next step.
        written: is handed the prediction (JSON) before the held-out drives are looked at.

    Raises:
        SteerdError: as `diagnose`.
    """
    warnings: list[str] = []

    def take(texts: Sequence[str]) -> None:
        warnings.extend(texts)
        warn(texts)

    progress(0.0, "reading the drives")
    case = make_case(request, take, lambda share: progress(LOADED * share, ""))
    span = DIAGNOSED - LOADED
    findings = _find_causes(
        request, case, lambda stage, share: progress(LOADED + span * share, stage), written
    )
    lane, why = None, ""
    if request.closed_loop:
        from steerd.daemon.analysis.gap_closed_loop import try_lane

        progress(DIAGNOSED, "driving the lane again")
        lane, why = try_lane(case.sessions, case.base, findings.values)
    return Diagnosis(case, findings, lane, why, tuple(warnings))


def _find_causes(
    request: DiagnoseRequest,
    case: Case,
    progress: Callable[[str, float], None],
    written: Callable[[str], None],
) -> Findings:
    from numpy.linalg import LinAlgError

    from steerd.sim_gap import diagnosis as engine
    from steerd.sysid.data.data_checks import DataError

    options = engine.Options(
        held_out=case.held_out or (),
        healthy=case.healthy,
        only=case.only,
        without=case.without,
        pairs=request.pairs,
        jobs=request.jobs,
        progress=progress,
        written=written,
    )
    try:
        return engine.diagnose(case.runs, case.base, options)
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None
    except FloatingPointError as error:
        raise SteerdError(str(error), _IDENTIFY, ExitCode.STOPPED) from None
    except LinAlgError:
        what = "the base car's simulation leaves every bound in some of these windows"
        raise SteerdError(what, _IDENTIFY, ExitCode.STOPPED) from None
    except (ValueError, OSError) as error:
        if takes_nothing(error):
            raise
        raise SteerdError(str(error), "", ExitCode.INVALID) from None
