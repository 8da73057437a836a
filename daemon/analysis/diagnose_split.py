"""Drives of a diagnosis divided: what is explained, and what is held out to measure it on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from math import floor
from typing import NamedTuple

import numpy as np

from steerd.daemon.analysis.drives import Warn, load_drives
from steerd.daemon.analysis.options import EVERY, HeldOut, Speed
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import describe_unused, make_segment, moving_segments

BLOCK = 6.5
"""Least length of a block: it holds two separate predictions 3 s ahead [s]."""
_OVER = 0.45
"""A block may be so much longer than whole seconds; more would make one window more of it [s]."""
FEWEST = 3
"""Of fewer blocks none is held out unless it is asked for."""
LEAST = 5.0
"""A gap is not identifiable from less driving than this [s]."""


class Split(NamedTuple):
    """Drives, cut to where the car moves."""

    runs: tuple[Run, ...]  # what is looked at
    later: Callable[[], Sequence[Run]] | None = None  # opens the drives that are held out
    held_out_of: str = ""  # what is held out, as text
    notes: tuple[str, ...] = ()  # what a reader should know


def split_drives(drives: Sequence[Run], held_out: HeldOut, speed: Speed, warn: Warn) -> Split:
    """Divide drives into those that are explained and those that measure the shrinkage.

    Args:
        drives: as loaded.
        held_out: what is held out.
        speed: of sessions that are opened later.
        warn: is handed what is doubtful in those.

    Raises:
        DataError: there is too little driving.
        SteerdError: there is too little to hold so much out.
    """
    parts, every, reserved = moving_segments(drives), held_out.every, held_out.files
    seconds = sum(run.driven for run in parts)
    if seconds < LEAST:
        what = f"only {seconds:.1f} s of driving at more than walking pace"
        raise DataError(what, "drive `steerd collect --plan mixed`")
    if reserved:
        past = drives[0].history

        def later() -> Sequence[Run]:
            opened = load_drives(reserved, speed, warn)
            return moving_segments([replace(drive, history=past) for drive in opened.runs])

        names = ", ".join(path.name for path in reserved)
        return Split(_in_blocks(drives, parts), later, names, _block_notes(drives))
    return _whole_sessions(drives, parts, every) or _some_blocks(drives, parts, every)


def _whole_sessions(
    drives: Sequence[Run], parts: tuple[Run, ...], every: int | None
) -> Split | None:
    """Every so many sessions held out whole; None if there are too few of them."""
    if every == 0:
        return None
    number = every or EVERY
    names = _sessions(drives)[number - 1 :: number]
    kept = tuple(run for run in parts if run.name in names)
    fitted = tuple(run for run in parts if run.name not in names)
    if not kept or not fitted:
        return None
    named = f"every {_ordinal(number)} session: {', '.join(sorted(names))}"
    return Split(_in_blocks(drives, fitted), lambda: kept, named, _block_notes(drives))


def _some_blocks(drives: Sequence[Run], parts: tuple[Run, ...], every: int | None) -> Split:
    """Every so many blocks held out, if that is asked for or there are enough of them."""
    blocks, notes = make_blocks(parts), _block_notes(drives)
    if every is None:
        every = min(EVERY, len(blocks)) if len(blocks) >= FEWEST else 0
    if every == 0:
        note = "nothing is held out: the shrinkage is predicted, not measured"
        return Split(_in_blocks(drives, parts), notes=(*notes, note))
    if len(blocks) < every:
        what = f"only {len(blocks)} blocks: too few to hold every {_ordinal(every)} out"
        raise SteerdError(what, "--held-out 0, or name a session", ExitCode.INVALID)
    kept = blocks[every - 1 :: every]
    fitted = tuple(b for i, b in enumerate(blocks) if i % every != every - 1)
    return Split(fitted, lambda: kept, f"every {_ordinal(every)} block of the drive", notes)


def _sessions(drives: Sequence[Run]) -> list[str]:
    """Names of the sessions, of which long ones are several drives."""
    return list(dict.fromkeys(run.name for run in drives))


def _ordinal(number: int) -> str:
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ends.get(number % 10, 'th')}"


def make_blocks(parts: Sequence[Run]) -> tuple[Run, ...]:
    """Parts cut into blocks of `BLOCK` seconds or more; no measurement is in two of them."""
    found: list[Run] = []
    for part in parts:
        start, end = float(part.pose.t[0]), min(float(part.pose.t[-1]), part.duration)
        edges = np.linspace(start, end, max(1, int((end - start) / BLOCK)) + 1)
        found += [
            make_segment(part, low, _whole_windows(low, high)) for low, high in pairwise(edges)
        ]
    return tuple(found)


def _whole_windows(low: float, high: float) -> float:
    """Where a block ends: its windows of about a second must not be shorter than that."""
    whole = floor(high - low)
    return min(high - 1e-6, low + whole + _OVER) if whole else high


def _in_blocks(drives: Sequence[Run], parts: tuple[Run, ...]) -> tuple[Run, ...]:
    """Few drives are cut, so that parts of them can be left out of fits."""
    return make_blocks(parts) if len(drives) < EVERY else parts


def _block_notes(drives: Sequence[Run]) -> tuple[str, ...]:
    unused = describe_unused(drives)
    if len(drives) >= EVERY:
        return unused
    count = len(_sessions(drives))
    what = "one session" if count == 1 else f"{count} sessions"
    first = f"{what}, cut into blocks of {BLOCK:g} s or more: they stand in for further drives"
    return (first, *unused)
