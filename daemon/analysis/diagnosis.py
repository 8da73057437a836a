"""`steerd.diagnose`: where simulation and car differ, why, and how far adding the cause helps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import CarFile, CarFileError, Learned
from steerd.daemon.analysis import options as asked
from steerd.daemon.analysis.car_output import make_car, with_known
from steerd.daemon.analysis.drives import Drives, load_drives, split_drives, without_reserved
from steerd.daemon.assembly.session_meta import read_session_car
from steerd.daemon.assembly.sim_car import compare_truths, read_origin
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import shown
from steerd.posterior_file import TABLES
from steerd.sim_gap import diagnosis as engine
from steerd.sim_gap.diagnosis import GapOptions
from steerd.sim_gap.report.to_json import to_json
from steerd.sim_gap.verdict.confidence import Cause
from steerd.steer_bus.session_read import Session
from steerd.sysid.data.segments import moving_segments
from steerd.sysid.estimation.preparation import add_command_history
from steerd.sysid.report.report import Report

LOADED, DIAGNOSED, DRIVEN = 0.05, 0.85, 0.95
"""Shares of the work done after loading, after the diagnosis, after the closed loop."""


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(GapOptions):
    """How to diagnose.

    Attributes:
        base: the car as believed: a car file, an `Identification`; None for the car file inside
            the first session.
        healthy: drives of the same car without the gap: they determine how large noise is.
        held_out: what the shrinkage is measured on: every k-th drive or block (default 4, 0 for
            none), or whole sessions.
        closed_loop: whether a lane drive is driven again in simulation, with and without.
        speed: `wheel` takes the measured wheel speed for the command, where a car did not obey it.
    """

    base: asked.CarSource = None
    healthy: asked.SessionSources = ()
    held_out: asked.HeldOutSource = None
    closed_loop: bool = True
    speed: asked.Speed = "command"


@shown
@dataclass(frozen=True, eq=False)
class Diagnosis(asked.Finding):
    """What `diagnose` found.

    `print(diagnosis)` is the screen of `steerd diagnose`.

    Attributes:
        base: the car as believed.
        drives: the sessions.
        findings: every number of the diagnosis.
        warnings: what is wrong or doubtful in the sessions.
    """

    SCREEN, CAR = 30, "diagnosed.toml"
    base: CarFile
    drives: Drives
    findings: engine.Diagnosis
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
        return self.findings.all_notes

    def make_car(self, path: Path) -> CarFile:
        """The base with the found effects, and with what still holds of what was known of it."""
        source = f"steerd diagnose: {', '.join(path.name for path in self.drives.paths)}"
        values = {}
        for cause in self.causes:  # what the base lacks, which need not be the car's change
            taken = zip(cause.parameters.items(), self.findings.values[cause.effect], strict=True)
            for (name, (_, sd, _)), value in taken:
                values[f"{cause.effect}.{name}"] = Learned(value, sd, source)
        car = make_car(self.base, values, path)
        sections = self.base.sections
        known = {name: sections[name] for name in TABLES if name in sections}
        # The covariance is about the base: it says nothing of an effect beyond it.
        if any(name in values for name in known.get("knowledge", {}).get("names", ())):
            del known["knowledge"]
        return with_known(car, known) if known else car

    def to_json(self) -> dict[str, Any]:
        """JSON values in the schema `steerd.gap/1`; what they rest on is under `residual`."""

        def runs(command: str) -> str:
            known = read_origin(self.drives.sessions[0].info().metadata)
            return self.drives.complete(f"`{command}`").strip("`") if known else command

        return to_json(self.findings, runs)

    def make_report(self, written: Path | None = None, report: Path | None = None) -> Report:
        """What screen, page and figure show; `written` and `report` are the files that were."""
        from steerd.sim_gap.report.gap_report import make_report

        if self.causes and written is not None:
            again = f" {lane.again}" if (lane := self.findings.lane) else ""
            following = self.drives.simulate_with(written, again)
        elif self.causes:
            following = "repeat with -o car.toml: simulation and controller then know the cause"
        elif report is not None:
            following = f"open {report} in a browser: it shows where the error lies"
        elif written is not None:
            base = f"{written} is the base as it was"
            following = f"--report gap.html shows where the error lies; {base}"
        else:
            following = "repeat with --report gap.html to see where the error lies"
        return make_report(self.findings, self.drives.complete, following)


def run_diagnose(paths: Sequence[Path], options: DiagnoseOptions, watch: asked.Watch) -> Diagnosis:
    """Find where the simulation of a car differs from its drives, and which effect causes it.

    The drives are files, or what `load` and `simulate` give. Returns verdict, causes with standard
    errors, predicted and measured shrinkage. Raises a `SteerdError` where a session, the car or an
    argument cannot be used; its `hint` says what to try.
    """
    watch.progress(0.0, "reading the drives")
    drives, case, base = make_case(paths, options, watch)
    span = DIAGNOSED - LOADED
    with drives.refusing(f"steerd identify {drives.names} -o car.toml, then --base car.toml"):
        findings = engine.diagnose(
            case, lambda stage, share: watch.progress(LOADED + span * share, stage), watch.written
        )
    if options.closed_loop:
        from steerd.daemon.analysis.gap_closed_loop import try_lane

        watch.progress(DIAGNOSED, "driving the lane again")
        lane, why = try_lane(drives.sessions, base, findings.values)
        findings = replace(findings, lane=lane, lane_note=why)
    return Diagnosis(base, drives, findings, tuple(watch.warnings))


diagnose = asked.by_keywords("diagnosing", DiagnoseOptions, run_diagnose)


def make_case(
    paths: Sequence[Path], options: DiagnoseOptions, watch: asked.Watch
) -> tuple[Drives, engine.Case, CarFile]:
    """The drives, what is diagnosed of them and the car.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    only, without = asked.read_effects(options.only), asked.read_effects(options.without)
    held_out, quiet = asked.read_held_out(options.held_out), asked.list_sessions(options.healthy)
    if only and not set(only) - set(without):
        raise UsageError("only and without leave no effect")
    sessions = without_reserved(paths, held_out.files, "diagnose", quiet)
    for path in held_out.files:  # opened later, but its absence is reported at once
        if not path.is_file():
            raise SteerdError(f"{path} does not exist", "", ExitCode.UNREADABLE)
    drives = load_drives(
        sessions, options.speed, watch, lambda share: watch.progress(LOADED * share)
    )
    watch.warn(compare_truths(drives.metadata))
    base, source, notes = find_base(options.base, drives.sessions)
    jitters = dict.fromkeys(d.log_jitter.describe() for d in drives.runs if d.log_jitter)
    without_gap = load_drives(quiet, options.speed, watch)
    with Drives((*drives.sessions, *without_gap.sessions), ()).refusing():
        past = add_command_history(without_gap.runs, base.model)
        case = engine.Case(
            add_command_history(drives.runs, base.model),
            base,
            replace(options, only=only, without=without),
            healthy=moving_segments(past) if quiet else (),
            sessions=tuple(path.name for path in drives.paths),
            base_source=source,
            notes=(*notes, *jitters),
        )
        return drives, split_drives(case, held_out, options.speed, watch), base


def find_base(
    named: asked.CarSource, sessions: Sequence[Session]
) -> tuple[CarFile, str, tuple[str, ...]]:
    """The car or car file named, else the one inside the first session, else the default.

    Returns:
        The car, where it comes from, notes.

    Raises:
        SteerdError: the one that counts cannot be used.
    """
    if named is not None:
        base = asked.read_car(named)
        return base, str(base.path), ()
    inside = [
        s.attachment("car.toml") if "car.toml" in s.info().attachments else b"" for s in sessions
    ]
    first = next((s for s, text in zip(sessions, inside, strict=True) if text), None)
    if first is None:
        note = "no --base, no car file in the sessions: the default car is assumed"
        return asked.read_car(None), "the default car (F1TENTH's figures)", (note,)
    try:
        base = read_session_car(first)
    except CarFileError as error:
        what = f"{first.info().path.name}: the car file inside cannot be used: {error.what}"
        raise SteerdError(what, "name one with --base car.toml") from None
    differ = f"the sessions' car files differ: the one inside {first.info().path.name} counts"
    notes = (differ,) if len({*inside}) > 1 else ()
    return base, "the car file inside the session", notes
