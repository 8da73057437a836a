"""`steerd.diagnose`: where simulation and car differ, why, and how far adding the cause helps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steerd.car_model.car_file import CarFile, CarFileError
from steerd.daemon.analysis.car_output import diagnosed_values, make_car, save_car, with_known
from steerd.daemon.analysis.diagnose_split import Case, split_drives
from steerd.daemon.analysis.diagnose_text import describe, following_words
from steerd.daemon.analysis.drives import (
    Warn,
    is_same,
    load_drives,
    refuse_copies,
    without_reserved,
)
from steerd.daemon.analysis.hints import complete, name_all, refusing
from steerd.daemon.analysis.identification import find_effects
from steerd.daemon.analysis.options import (
    CarSource,
    DiagnoseOptions,
    HeldOut,
    SessionSources,
    by_keywords,
    list_sessions,
    read_car,
    read_held_out,
)
from steerd.daemon.assembly.session_meta import read_session_car
from steerd.daemon.assembly.sim_car import compare_truths, read_origin
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.notebook import notebook_progress
from steerd.daemon.common.screen import shown
from steerd.posterior_file import TABLES
from steerd.sim_gap import diagnosis as gap
from steerd.sim_gap.lane_comparison import LaneComparison, encode_lane
from steerd.sim_gap.report.to_json import to_json
from steerd.sim_gap.verdict.evidence import Cause
from steerd.steer_bus.session_read import Session
from steerd.sysid.data.segments import moving_segments
from steerd.sysid.estimation.preparation import add_command_history
from steerd.sysid.report.report import Card

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOADED, DIAGNOSED, DRIVEN = 0.05, 0.85, 0.95
"""Shares of the work done after loading, after the diagnosis, after the closed loop."""


@shown
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
    findings: gap.Diagnosis
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
        return (*self.case.split.notes, *self.findings.notes, *lane)

    @property
    def cards(self) -> list[Card]:
        """The figures that the report shows first."""
        from steerd.sim_gap.report.gap_report import make_cards

        return list(make_cards(self.findings))

    @cached_property
    def car(self) -> CarFile:
        """The base with the found effects: simulate with it, or design from it."""
        return self.make_car(Path("diagnosed.toml"))

    def save_car(self, path: Path | str) -> Path:
        """Write the car file and what is known of the car, see `save_car`."""
        return save_car(Path(path), self.make_car(Path(path)), self.car)

    def __str__(self) -> str:
        return self.describe()

    def make_car(self, path: Path) -> CarFile:
        """The base with the found effects, and with what still holds of what was known of it."""
        values = diagnosed_values(self.causes, self.case.drives.paths)
        car = make_car(self.case.base, values, path)
        sections = self.case.base.sections
        known = {name: sections[name] for name in TABLES if name in sections}
        # The covariance is about the base: it says nothing of an effect beyond it.
        if any(name in values for name in known.get("knowledge", {}).get("names", ())):
            del known["knowledge"]
        return with_known(car, known) if known else car

    def to_json(self) -> dict[str, Any]:
        """JSON values in the schema `steerd.gap/1`; what they rest on is under `residual`."""
        data = to_json(self.findings)
        sessions = self.case.drives.sessions
        if data["next_manoeuvre"] and read_origin(sessions[0].info().metadata):
            command = data["next_manoeuvre"]["command"]
            data["next_manoeuvre"]["command"] = complete(f"`{command}`", sessions).strip("`")
        data["residual"] |= {
            "sessions": [path.name for path in self.case.drives.paths],
            "base": self.case.base_source,
            "held_out_of": self.case.split.held_out_of or None,
            "prediction": self.findings.shrinkage.text,
            "notes": list(self.notes),
            "closed_loop": None if self.lane is None else encode_lane(self.lane),
        }
        return data

    def render_report(self) -> str:
        """The report."""
        from steerd.sim_gap.report.gap_report import Subject, make_report
        from steerd.sysid.report.page import render_report

        case, split = self.case, self.case.split
        notes = (*split.notes, self.lane_note) if self.lane_note else split.notes
        names = tuple(path.name for path in case.drives.paths)
        following = following_words(case, self.findings)
        subject = Subject(
            names, split.seconds, case.base_source, split.held_out_of, following, notes
        )
        return render_report(make_report(subject, self.findings, self.lane))

    def plot(self) -> "Figure":
        """Prediction errors before and after, candidate effects, the gap over time."""
        from steerd.daemon.analysis.figures import plot_diagnosis

        return plot_diagnosis(self.findings)

    def describe(self, written: Path | None = None, report: Path | None = None) -> str:
        """The screen; `written` and `report` are the files that were."""
        return describe(self.case, self.findings, self.lane or self.lane_note, written, report)


@by_keywords(DiagnoseOptions)
def diagnose(sessions: SessionSources, options: DiagnoseOptions) -> Diagnosis:
    """Find where the simulation of a car differs from its drives, and which effect causes it.

    The drives are files, or what `load` and `simulate` give. Returns verdict, causes with standard
    errors, predicted and measured shrinkage. Raises a `SteerdError` where a session, the car or an
    argument cannot be used; its `hint` says what to try.
    """
    with notebook_progress("diagnosing", 1.0) as progress:
        return run_diagnosis(list_sessions(sessions), options, progress=progress)


def run_diagnosis(
    paths: Sequence[Path],
    options: DiagnoseOptions,
    warn: Warn = lambda texts: None,
    progress: Callable[[float, str], None] = lambda done, step: None,
    written: Callable[[str], None] = lambda prediction: None,
) -> Diagnosis:
    """Read the drives, diagnose, drive the lane again.

    Args:
        paths: the sessions.
        options: what to diagnose.
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
    case = make_case(paths, options, take, lambda share: progress(LOADED * share, ""))
    span = DIAGNOSED - LOADED
    names = name_all(case.drives.paths)
    identify = f"steerd identify {names} -o car.toml, then --base car.toml"
    with refusing(case.drives.sessions, identify):
        findings = gap.diagnose(case.split.runs, case.base, gap.Options(
            held_out=case.split.later or (), healthy=case.healthy, only=case.only or None,
            without=case.without, pairs=options.pairs, written=written,
            progress=lambda stage, share: progress(LOADED + span * share, stage),
        ))  # fmt: skip
    lane, why = None, ""
    if options.closed_loop:
        from steerd.daemon.analysis.gap_closed_loop import try_lane

        progress(DIAGNOSED, "driving the lane again")
        lane, why = try_lane(case.drives.sessions, case.base, findings.values)
    return Diagnosis(case, findings, lane, why, tuple(warnings))


def make_case(
    paths: Sequence[Path], options: DiagnoseOptions, warn: Warn, advance: Callable[[float], None]
) -> Case:
    """Everything that can be refused is refused here.

    Args:
        paths: the sessions.
        options: what to diagnose.
        warn: is handed what is doubtful in the sessions.
        advance: is called with the share of the files read.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    only, without = find_effects(options.only), find_effects(options.without)
    held_out, quiet = read_held_out(options.held_out), list_sessions(options.healthy)
    if only and not set(only) - set(without):
        raise SteerdError("only and without leave no effect", "", ExitCode.USAGE)
    sessions = without_reserved(paths, held_out.files, "diagnose")
    _check(options, held_out, sessions, quiet)
    drives = load_drives(sessions, options.speed, warn, advance)
    warn(compare_truths(drives.metadata))
    base, source, notes = find_base(options.base, drives.sessions)
    jitters = dict.fromkeys(" ".join(d.log_jitter.describe()) for d in drives.runs if d.log_jitter)
    without_gap = load_drives(quiet, options.speed, warn)
    with refusing((*drives.sessions, *without_gap.sessions)):
        runs = add_command_history(drives.runs, base.model, asked=True)
        split = split_drives(runs, held_out, options.speed, warn)
        past = add_command_history(without_gap.runs, base.model, asked=True)
        healthy = moving_segments(past) if quiet else ()
    split = split._replace(notes=(*notes, *jitters, *split.notes))
    return Case(drives, split, healthy, base, source, only, without)


def _check(
    options: DiagnoseOptions, held_out: HeldOut, sessions: Sequence[Path], quiet: Sequence[Path]
) -> None:
    if options.jobs < 1:
        raise SteerdError(f"jobs {options.jobs}: 1 or more", "", ExitCode.USAGE)
    for path in held_out.files:  # opened later, but its absence is reported at once
        if not path.is_file():
            raise SteerdError(f"{path} does not exist", "", ExitCode.UNREADABLE)
    refuse_copies(quiet)
    for path in quiet:
        if any(is_same(path, each) for each in (*sessions, *held_out.files)):
            what = f"healthy {path} is one of the drives to explain: its gap would pass for noise"
            raise SteerdError(what, "name a drive without the gap", ExitCode.USAGE)


def find_base(
    named: CarSource, sessions: Sequence[Session]
) -> tuple[CarFile, str, tuple[str, ...]]:
    """The car or car file named, else the one inside the first session, else the default.

    Returns:
        The car, where it comes from, notes.

    Raises:
        SteerdError: the one that counts cannot be used.
    """
    if named is not None:
        base = read_car(named)
        return base, str(base.path), ()
    inside = [
        s.attachment("car.toml") if "car.toml" in s.info().attachments else b"" for s in sessions
    ]
    first = next((s for s, text in zip(sessions, inside, strict=True) if text), None)
    if first is None:
        note = "no --base, no car file in the sessions: the default car is assumed"
        return read_car(None), "the default car (F1TENTH's figures)", (note,)
    try:
        base = read_session_car(first)
    except CarFileError as error:
        what = f"{first.info().path.name}: the car file inside cannot be used: {error.what}"
        raise SteerdError(what, "name one with --base car.toml", ExitCode.INVALID) from None
    differ = f"the sessions' car files differ: the one inside {first.info().path.name} counts"
    notes = (differ,) if len({*inside}) > 1 else ()
    return base, "the car file inside the session", notes
