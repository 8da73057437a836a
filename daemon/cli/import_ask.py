"""The conversation of `steerd import --ask`: a proposed map, what it would mean, changes, yes."""

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steerd.daemon.common.errors import SteerdError, UsageError
from steerd.daemon.common.packaged import EXAMPLE_MAP
from steerd.daemon.common.screen import wrap
from steerd.daemon.imports.propose import Proposal, change, format_map, list_sections

if TYPE_CHECKING:
    from steerd.daemon.sessions.info import SessionReport

Trial = Callable[[Path, Path], object]  # imports by a map file into a session file
_LEFT, _MM = "must be left positive", "millimetres"


def ask(proposal: Proposal, source: Path, trial: Trial) -> str:
    """Talk about a proposal for a log until somebody agrees; the text of the map.

    Raises SteerdError: nobody agreed.
    """
    text = _show(proposal, source, trial, fix=True)
    while True:
        print("Enter writes it; NAME = COLUMN [* SCALE] changes a line; ? lists names; q leaves")
        print("> ", end="", flush=True)
        line = sys.stdin.readline()
        answer = line.strip()
        if not line or answer == "q":
            raise UsageError("nothing was written")
        if answer == "?":
            print(*wrap(", ".join(list_sections(proposal)), "  ", "  "), sep="\n")
        elif answer:
            wrong = change(proposal, answer)
            if wrong:
                print(f"  {wrong}")
            else:
                text = _show(proposal, source, trial, fix=False)
        elif text:
            return text
        else:
            print("  it cannot be imported like this")


def _show(proposal: Proposal, source: Path, trial: Trial, *, fix: bool) -> str:
    """Print the map and its meaning; the map's text, or nothing where it does not work."""
    found, problem = None, ""
    try:
        found = _try(proposal, source, trial)
        if fix and _fix(proposal, *found[1:]):
            found = _try(proposal, source, trial)
    except SteerdError as error:
        no_file = error.hint and str(EXAMPLE_MAP) not in error.hint
        found, problem = None, f"{error.what}; {error.hint}" if no_file else error.what
    text = format_map(proposal, source.name)
    print("\nproposed map")
    print(*(f"  {line}" for line in text.splitlines() if line.strip()), sep="\n")
    print("\nwhat it would mean")
    if found is None:
        print(f"  nothing yet: {problem}")
        return ""
    lines, doubts, _ = found
    print(*(f"  {line}" for line in lines), sep="\n")
    print(*(f"  doubtful: {doubt}\n" for doubt in doubts), sep="", end="")
    return text


def _try(
    proposal: Proposal, source: Path, trial: Trial
) -> tuple[list[str], tuple[str, ...], float | None]:
    """What the map makes of the log: in words, what looks wrong, ERPM per m/s by the poses.

    Raises SteerdError: it cannot be imported like this.
    """
    from steerd.daemon.sessions.info import load_recording, make_session_report
    from steerd.daemon.sessions.motion import find_erpm_gain, round_gain
    from steerd.steer_bus.topics import VESC

    with tempfile.TemporaryDirectory(prefix="steerd-") as folder:
        the_map, out = Path(folder) / "map.toml", Path(folder) / "trial.mcap"
        the_map.write_text(format_map(proposal, source.name), encoding="utf-8")
        try:
            trial(the_map, out)
        except SteerdError as error:
            what = error.what.replace(f"map {the_map}", "the map")
            raise SteerdError(what, error.hint, error.code) from error
        read = load_recording(out)
        report, track = make_session_report(read), read.track
        gain = find_erpm_gain(track, read.signal(VESC, "erpm"))
    gain = None if gain is None else round_gain(gain)
    lines = _lines(report, None if track is None else track.yaw, gain)
    return [*lines], report.warnings, gain


def _lines(report: "SessionReport", yaw: "np.ndarray | None", gain: float | None) -> Iterator[str]:
    yield f"{report.info.duration_s:.1f} s, {report.info.count} messages"
    if report.length_m is not None:
        yield f"driven    {report.length_m:.1f} m"
    if report.speed:
        yield f"speed     {report.speed.low:.2f} to {report.speed.high:.2f} m/s"
    if yaw is not None and len(yaw) > 1:
        turn = np.diff(np.unwrap(yaw))
        left, right = degrees(turn.clip(0.0).sum()), degrees((-turn).clip(0.0).sum())
        yield f"turned    {left:.0f}° to the left, {right:.0f}° to the right"
    if report.steer:
        low, high = report.steer.low, report.steer.high
        yield f"steering  {degrees(low):+.1f} to {degrees(high):+.1f}°, left is positive"
    if gain is not None:
        yield f"motor     {gain:.0f} ERPM per m/s, by the poses"


def _fix(proposal: Proposal, doubts: Sequence[str], erpm_gain: float | None) -> bool:
    """Change what the drive itself says must be otherwise; whether anything was."""
    text, fixed = " ".join(doubts), False
    columns = proposal.get("columns", {})
    if _LEFT in text and "steer_cmd" in columns:
        old = columns["steer_cmd"]
        name, scale = (old, 1.0) if isinstance(old, str) else (old["column"], old["scale"])
        columns["steer_cmd"], fixed = {"column": name, "scale": -scale}, True
    if "topics" in proposal and _MM in text:
        proposal.setdefault("frame", {})["units"], fixed = "mm", True
    if erpm_gain is not None and "--erpm-gain" in text:
        proposal.setdefault("vesc", {})["erpm_gain"] = erpm_gain
        fixed = True
    return fixed
