"""Drives of a diagnosis divided: what is explained, and what is held out to measure it on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from steerd.daemon.analysis.drives import Warn, load_drives
from steerd.daemon.analysis.options import EVERY, HeldOut, Speed
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import describe_unused, make_blocks, moving_segments, split_every

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
    parts, every = moving_segments(drives), held_out.every
    seconds = sum(run.driven for run in parts)
    if seconds < LEAST:
        what = f"only {seconds:.1f} s of driving at more than walking pace"
        raise DataError(what, "drive `steerd collect --plan mixed`")
    # Of long sessions there are several drives. Few drives are cut, so that parts of them can be
    # left out of fits.
    sessions, few = list(dict.fromkeys(run.name for run in drives)), len(drives) < EVERY
    notes = describe_unused(drives)
    if few:
        count = "one session" if len(sessions) == 1 else f"{len(sessions)} sessions"
        note = f"{count}, cut into blocks of {BLOCK:g} s or more: they stand in for further drives"
        notes = (note, *notes)
    cut = partial(make_blocks, length=BLOCK, count=int, over=_OVER)
    blocks = cut(parts)
    if held_out.files:
        past = drives[0].history

        def later() -> Sequence[Run]:
            opened = load_drives(held_out.files, speed, warn)
            return moving_segments([replace(drive, history=past) for drive in opened.runs])

        names = ", ".join(path.name for path in held_out.files)
        return Split(blocks if few else parts, later, names, notes)
    number = every or EVERY
    out = sessions[number - 1 :: number]
    whole = tuple(run for run in parts if run.name in out)
    fitted = tuple(run for run in parts if run.name not in out)
    if every != 0 and whole and fitted:
        named = f"every {_ordinal(number)} session: {', '.join(sorted(out))}"
        return Split(cut(fitted) if few else fitted, lambda: whole, named, notes)
    if every is None:
        every = min(EVERY, len(blocks)) if len(blocks) >= FEWEST else 0
    if every == 0:
        note = "nothing is held out: the shrinkage is predicted, not measured"
        return Split(blocks if few else parts, notes=(*notes, note))
    if len(blocks) < every:
        what = f"only {len(blocks)} blocks: too few to hold every {_ordinal(every)} out"
        raise SteerdError(what, "--held-out 0, or name a session", ExitCode.INVALID)
    fitted, kept = split_every(blocks, every)
    return Split(fitted, lambda: kept, f"every {_ordinal(every)} block of the drive", notes)


def _ordinal(number: int) -> str:
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ends.get(number % 10, 'th')}"
