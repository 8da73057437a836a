"""The one screen that `steerd diagnose` prints: at most 30 lines of 80 columns."""

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from steerd.daemon.analysis.diagnose_case import Case
from steerd.sim_gap.diagnosis import Diagnosis as Findings
from steerd.sim_gap.lane_comparison import LaneComparison
from steerd.sim_gap.report.summary_text import (
    ambiguity,
    cause_words,
    gap_words,
    headline,
    lane_words,
    manoeuvre_words,
    residual_words,
    shrink_words,
)

COLUMNS, LINES = 80, 30
_MARGIN = 12
_OTHER_SHOWN = 0.005


class Described(Protocol):
    """What the screen shows of a diagnosis (`steerd.daemon.analysis.diagnosis.Diagnosis`)."""

    @property
    def case(self) -> Case:
        """Drives, base car and what was held out."""
        ...

    @property
    def findings(self) -> Findings:
        """Every number of the diagnosis."""
        ...

    @property
    def lane(self) -> LaneComparison | None:
        """The session's lane driven again in simulation; None if that was not possible."""
        ...

    @property
    def lane_note(self) -> str:
        """Why not; empty if it was, or was not asked for."""
        ...


def describe(diagnosis: Described, written: Path | None = None, report: Path | None = None) -> str:
    """The screen; what matters least is left out where it would not fit.

    Args:
        diagnosis: what was found.
        written: the car file that was written.
        report: the report that was written.
    """
    must = [line for label, text in _rows(diagnosis) for line in _wrap(label, text)]
    # The last line is a command to copy: never broken.
    last = [f"{'next':<{_MARGIN}}{_next(diagnosis, written, report)}"]
    notes = (*diagnosis.case.notes, *diagnosis.findings.notes)
    lines = [line for note in notes for line in _wrap("note", _shortened(note))]
    room = LINES - len(must) - len(last)
    return "\n".join([*must[: LINES - len(last)], *lines[: max(room, 0)], *last])


def _shortened(note: str) -> str:
    return textwrap.shorten(note, COLUMNS - _MARGIN, placeholder=" …")


def _wrap(label: str, text: str) -> list[str]:
    """A labelled paragraph, three lines of it at most."""
    return textwrap.wrap(
        text, COLUMNS, initial_indent=f"{label:<{_MARGIN}}", subsequent_indent=" " * _MARGIN,
        max_lines=3, placeholder=" …", break_on_hyphens=False,
    )  # fmt: skip


def _rows(diagnosis: Described) -> Iterator[tuple[str, str]]:
    case, found, lane = diagnosis.case, diagnosis.findings, diagnosis.lane
    names = ", ".join(path.name for path in case.sessions)
    yield "drives", f"{case.seconds:.0f} s to explain, of {names}; base: {case.base_source}"
    yield "verdict", f"{found.verdict.upper()}. {headline(found)}"
    if found.verdict != "none":
        yield "where", found.where.sentence
    for cause in found.causes:
        yield "cause", f"{cause.effect}: {cause_words(cause)}, confidence {cause.confidence:.0%}"
        if ambiguity(cause):
            yield "confounded", ambiguity(cause)
    if found.causes and found.something_else >= _OTHER_SHOWN:
        yield "", f"something else than the library's effects: {found.something_else:.0%}"
    if found.verdict in ("unexplained", "partial"):
        yield "left over", residual_words(found)
    yield "gap after", "; ".join(gap_words(found))
    if found.causes:
        yield "shrinks by", shrink_words(found, case.held_out_of)
        yield "", f"prediction sha256 {found.shrinkage.digest}"
    if lane is not None:
        yield "closed loop", lane_words(lane)
    elif diagnosis.lane_note and found.causes:
        yield "closed loop", diagnosis.lane_note.removeprefix("closed loop ")
    yield "drive next", manoeuvre_words(found)


def _next(diagnosis: Described, written: Path | None, report: Path | None) -> str:
    """The command to type next."""
    causes, lane = diagnosis.findings.causes, diagnosis.lane
    if not causes and report is not None:
        return f"open {report} in a browser: it shows where the error lies"
    if not causes and written is not None:
        return f"--report gap.html shows where the error lies; {written} is the base as it was"
    if not causes:
        return "repeat with --report gap.html to see where the error lies"
    if written is None:
        return "repeat with -o car.toml; steerd run --sim --car car.toml then drives like the car"
    again = f" {lane.again}" if lane is not None else ""
    return f"steerd run --sim --fast --duration 20 --car {written}{again}"
