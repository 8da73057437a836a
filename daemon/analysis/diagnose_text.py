"""The one screen that `steerd diagnose` prints: at most 30 lines of 80 columns."""

from collections.abc import Iterator
from pathlib import Path

from steerd.daemon.analysis.diagnose_split import Case
from steerd.daemon.analysis.hints import complete, simulate_with
from steerd.daemon.common.screen import wrap
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

COLUMNS, LINES = 80, 30
_MARGIN, _ROWS = 12, 3
_OTHER_SHOWN = 0.005


def describe(
    case: Case,
    found: Diagnosis,
    lane: LaneComparison | str,
    written: Path | None = None,
    report: Path | None = None,
) -> str:
    """The screen; what matters least is left out where it would not fit.

    Args:
        case: drives and base car.
        found: what was found.
        lane: the session's lane driven again in simulation, or why it was not.
        written: the car file that was written.
        report: the report that was written.
    """
    must = [line for label, text in _rows(case, found, lane) for line in _wrap(label, text)]
    # The last line is a command to copy: never broken.
    last = [f"{'next':<{_MARGIN}}{_next(case, found, lane, written, report)}"]
    notes = (*case.split.notes, *found.notes)
    lines = [line for note in notes for line in _wrap("note", note)]
    room = LINES - len(must) - len(last)
    return "\n".join([*must[: LINES - len(last)], *lines[: max(room, 0)], *last])


def _wrap(label: str, text: str) -> list[str]:
    """A labelled paragraph, three lines of it at most."""
    lines = wrap(text, f"{label:<{_MARGIN}}", " " * _MARGIN, COLUMNS)
    if len(lines) <= _ROWS:
        return lines
    return [*lines[: _ROWS - 1], f"{lines[_ROWS - 1][: COLUMNS - 2]} …"]


def _rows(case: Case, found: Diagnosis, lane: LaneComparison | str) -> Iterator[tuple[str, str]]:
    split, names = case.split, ", ".join(path.name for path in case.drives.paths)
    yield "drives", f"{split.seconds:.0f} s to explain, of {names}; base: {case.base_source}"
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
        yield "shrinks by", shrink_words(found, split.held_out_of)
        yield "", f"prediction sha256 {found.shrinkage.digest[:16]}…"
    if isinstance(lane, LaneComparison):
        yield "closed loop", lane_words(lane)
    elif lane and found.causes:
        yield "closed loop", lane.removeprefix("closed loop ")
    yield "drive next", following_words(case, found)


def following_words(case: Case, found: Diagnosis) -> str:
    """What to drive next, with a command that runs as printed."""
    return complete(manoeuvre_words(found), case.drives.sessions)


def _next(
    case: Case,
    found: Diagnosis,
    lane: LaneComparison | str,
    written: Path | None,
    report: Path | None,
) -> str:
    """The command to type next."""
    causes = found.causes
    if not causes and report is not None:
        return f"open {report} in a browser: it shows where the error lies"
    if not causes and written is not None:
        return f"--report gap.html shows where the error lies; {written} is the base as it was"
    if not causes:
        return "repeat with --report gap.html to see where the error lies"
    if written is None:
        return "repeat with -o car.toml: simulation and controller then know the cause"
    again = f" {lane.again}" if isinstance(lane, LaneComparison) else ""
    return simulate_with(written, case.drives.sessions, again)
