"""The one screen that `steerd diagnose` prints: at most 24 lines of 100 columns."""

import textwrap
from collections.abc import Iterator
from pathlib import Path

from steerd.daemon.analysis.diagnose_case import Case
from steerd.sim_gap.diagnosis import Diagnosis
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

COLUMNS, LINES = 100, 24
_MARGIN = 12


def describe(
    case: Case,
    told: Diagnosis,
    lane: LaneComparison | None,
    why: str,
    written: Path | None,
    report: Path | None = None,
) -> str:
    """The screen; what matters least is left out where it would not fit."""
    must = [line for label, text in _rows(case, told, lane, why) for line in _wrap(label, text)]
    last = [
        f"{'next':<{_MARGIN}}{_next(told, lane, written, report)}"
    ]  # to be copied: never broken
    notes = [
        line for note in (*case.notes, *told.notes) for line in _wrap("note", _shortened(note))
    ]
    room = LINES - len(must) - len(last)
    return "\n".join([*must[: LINES - len(last)], *notes[: max(room, 0)], *last])


def _shortened(note: str) -> str:
    return textwrap.shorten(note, COLUMNS - _MARGIN, placeholder=" …")


def _wrap(label: str, text: str) -> list[str]:
    """A labelled paragraph, three lines of it at most."""
    return textwrap.wrap(
        text, COLUMNS, initial_indent=f"{label:<{_MARGIN}}", subsequent_indent=" " * _MARGIN,
        max_lines=3, placeholder=" …", break_on_hyphens=False,
    )  # fmt: skip


def _rows(
    case: Case, told: Diagnosis, lane: LaneComparison | None, why: str
) -> Iterator[tuple[str, str]]:
    names = ", ".join(path.name for path in case.sessions)
    yield "drives", f"{case.seconds:.0f} s to explain, of {names}; base: {case.base_words}"
    yield "verdict", f"{told.verdict.upper()}. {headline(told)}"
    if told.verdict != "none":
        yield "where", told.where.sentence
    for cause in told.causes[:2]:
        yield "cause", f"{cause.effect}: {cause_words(cause)}, confidence {cause.confidence:.0%}"
        if ambiguity(cause):
            yield "  not told", ambiguity(cause)
    if told.verdict in ("unexplained", "partial"):
        yield "left over", residual_words(told)
    yield "gap after", "; ".join(gap_words(told))
    if told.causes:
        yield "shrinks by", shrink_words(told, case.held_out_of)
        yield "", f"sha256 of the prediction: {told.shrinkage.digest}"
    if lane is not None:
        yield "closed loop", lane_words(lane)
    elif why and told.causes:
        yield "closed loop", why.removeprefix("closed loop ")
    yield "drive next", manoeuvre_words(told)


def _next(
    told: Diagnosis, lane: LaneComparison | None, written: Path | None, report: Path | None
) -> str:
    """The command to type next."""
    if not told.causes and report is not None:
        return f"open {report} in a browser: it shows where the error lies"
    if not told.causes and written is not None:
        return f"--report gap.html shows where the error lies; {written} is the base as it was"
    if not told.causes:
        return "repeat with --report gap.html to see where the error lies"
    if written is None:
        return "repeat with -o car.toml, then steerd run --sim --car car.toml shows the car's ways"
    again = f" {lane.again}" if lane is not None else ""
    return f"steerd run --sim --fast --duration 20 --car {written}{again}"
