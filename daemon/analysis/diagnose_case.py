"""What `steerd diagnose` is asked, checked: drives, what is kept back, the base car, the noise."""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import floor
from pathlib import Path

import numpy as np

from steerd.car_model.car_file import CarFile, CarFileError, default_car_path, parse_car
from steerd.car_model.effects import find_effect
from steerd.daemon.analysis.drives import (
    is_same,
    load_base,
    load_drive,
    refuse_copies,
    without_reserved,
)
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.session_read import SessionError, open_session
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import make_segment, moving_segments
from steerd.sysid.estimation.prediction_horizon import remembering

EVERY = 4
"""Unless said otherwise every 4th block or session is kept back."""
BLOCK = 6.5
"""Least length of a block: the error of predictions 3 s ahead can be told twice in it [s]."""
_OVER = 0.45
"""A block may be so much longer than whole seconds; more would make one window more of it [s]."""
FEWEST = 3
"""Of fewer blocks none is kept back unless `--runs-held-out` says so."""
LEAST = 5.0
"""Less driving than this tells nothing of a gap [s]."""


@dataclass(frozen=True, eq=False)
class Case:
    """A diagnosis to make.

    Attributes:
        sessions: the files whose drives are looked at.
        runs: their drives, cut to where the car moves.
        held_out: opens the drives that are kept back; None if none are.
        held_out_of: what is kept back, in words.
        healthy: drives without the gap.
        base: the car as believed.
        base_words: where it comes from.
        only, without: effects by their names; `only` None for the library.
        notes: what a reader should know.
    """

    sessions: tuple[Path, ...]
    runs: tuple[Run, ...]
    held_out: Callable[[], Sequence[Run]] | None
    held_out_of: str
    healthy: tuple[Run, ...]
    base: CarFile
    base_words: str
    only: tuple[str, ...] | None
    without: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Driving that is looked at [s]."""
        return sum(run.duration for run in self.runs)


def make_case(args: argparse.Namespace, advance: Callable[[float], None]) -> Case:
    """Everything that can be refused is refused here.

    Args:
        args: the command line.
        advance: told the share of the files read.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    only = tuple(_effect(name) for name in args.only) or None
    without = tuple(_effect(name) for name in args.without)
    if only is not None and not set(only) - set(without):
        raise SteerdError("--only and --without leave no effect", "", ExitCode.USAGE)
    every, reserved = parse_held_out(args.runs_held_out)
    refuse_copies(reserved)
    sessions = without_reserved(args.sessions, reserved, "diagnose")
    sound = [Path(name) for name in _listed(args.healthy)]
    _refuse_healthy(sound, (*sessions, *reserved))
    for path in reserved:
        _check_there(path)
    drives = []
    for number, path in enumerate(sessions):
        drives.append(load_drive(path, args.speed))
        advance((number + 1) / len(sessions))
    base, words, notes = find_base(args.base, sessions)
    jitters = tuple(" ".join(drive.log_jitter.describe()) for drive in drives if drive.log_jitter)
    drives = remembering(drives, base.model, ())
    healthy = [load_drive(path, args.speed) for path in sound]
    healthy = remembering(healthy, base.model, ())
    runs, later, told, more = _split(drives, every, reserved, args.speed)
    return Case(
        sessions, runs, later, told, _moving(healthy) if healthy else (), base, words, only,
        without, (*notes, *jitters, *more),
    )  # fmt: skip


def _effect(name: str) -> str:
    try:
        return find_effect(name).name
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint or "`steerd effects` lists them", ExitCode.USAGE) from None


def _listed(given: Sequence[str]) -> list[str]:
    """Values of a repeatable option that may also be separated by commas."""
    return [part for text in given for part in text.split(",") if part]


def parse_held_out(given: Sequence[str]) -> tuple[int | None, tuple[Path, ...]]:
    """Every how many drives (0: none, None: not said), or the files to keep back.

    Raises:
        SteerdError: it is neither.
    """
    listed = _listed(given)
    if not listed:
        return None, ()
    if len(listed) == 1 and listed[0].lstrip("-").isdigit():
        every = int(listed[0])
        if every < 0 or every == 1:
            what = f"--runs-held-out {every}: every K-th drive, 2 or more; 0 keeps nothing back"
            raise SteerdError(what, "", ExitCode.USAGE)
        return every, ()
    return None, tuple(Path(name) for name in listed)


def _refuse_healthy(healthy: Sequence[Path], others: Sequence[Path]) -> None:
    """A drive that is to be explained would teach the noise its own gap."""
    refuse_copies(healthy)
    for path in healthy:
        if any(is_same(path, each) for each in others):
            what = f"--healthy {path} is one of the drives to explain: its gap would pass for noise"
            raise SteerdError(what, "name a drive without the gap", ExitCode.USAGE)


def _check_there(path: Path) -> None:
    """A reserved session is not opened yet, but its absence is told at once."""
    if not path.is_file():
        raise SteerdError(f"{path} does not exist", "", ExitCode.UNREADABLE)


def find_base(named: Path | None, sessions: Sequence[Path]) -> tuple[CarFile, str, list[str]]:
    """The car file named, else the one inside the first session, else the default.

    Raises:
        SteerdError: the one that counts cannot be used.
    """
    if named is not None:
        return load_base(named), str(named), []
    texts = [text for text in map(_embedded, sessions) if text is not None]
    if not texts:
        note = "no session holds its car file, and no --base is given: the default car is assumed"
        return load_base(default_car_path()), "the default car (F1TENTH's figures)", [note]
    notes = []
    if any(text != texts[0] for text in texts) or len(texts) < len(sessions):
        notes.append(f"the sessions' car files differ: the one inside {sessions[0].name} counts")
    try:
        base = parse_car(texts[0], Path("car.toml"))
    except CarFileError as error:
        what = f"{sessions[0].name}: the car file inside cannot be used: {error.what}"
        raise SteerdError(what, "name one with --base car.toml", ExitCode.INVALID) from None
    return base, "the car file inside the session", notes


def _embedded(path: Path) -> str | None:
    """The car file that a session carries; None if there is none."""
    try:
        return open_session(path).attachment("car.toml").decode()
    except (SessionError, UnicodeDecodeError):
        return None


def _moving(drives: Sequence[Run]) -> tuple[Run, ...]:
    try:
        return moving_segments(drives)
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None


Later = Callable[[], Sequence[Run]] | None


def _split(
    drives: Sequence[Run], every: int | None, reserved: Sequence[Path], speed: str
) -> tuple[tuple[Run, ...], Later, str, list[str]]:
    """Drives to look at, how to open the others, both in words."""
    parts = _moving(drives)
    seconds = sum(run.duration for run in parts)
    if seconds < LEAST:
        what = f"only {seconds:.1f} s of driving at more than walking pace"
        raise SteerdError(what, "drive `steerd collect --plan mixed`", ExitCode.INVALID)
    if reserved:
        words = ", ".join(path.name for path in reserved)
        past = drives[0].history

        def later() -> Sequence[Run]:
            return _moving([replace(load_drive(path, speed), history=past) for path in reserved])

        return _in_blocks(drives, parts), later, words, _block_notes(drives)
    whole = _whole_sessions(drives, parts, every or EVERY) if every != 0 else None
    if whole is not None:
        return whole
    return _some_blocks(drives, parts, every)


Split = tuple[tuple[Run, ...], Later, str, list[str]]


def _whole_sessions(drives: Sequence[Run], parts: tuple[Run, ...], every: int) -> Split | None:
    """Every so many sessions kept back whole; None if there are too few of them."""
    names = {run.name for run in drives[every - 1 :: every]}
    kept = tuple(run for run in parts if run.name in names)
    fitted = tuple(run for run in parts if run.name not in names)
    if len(drives) < every or not kept or not fitted:
        return None
    words = f"every {_ordinal(every)} session: {', '.join(sorted(names))}"
    return _in_blocks(drives, fitted), lambda: kept, words, _block_notes(drives)


def _some_blocks(drives: Sequence[Run], parts: tuple[Run, ...], every: int | None) -> Split:
    """Every so many blocks kept back, if that is asked for or there are enough of them."""
    cut_up, notes = cut_blocks(parts), _block_notes(drives)
    if every is None:
        every = min(EVERY, len(cut_up)) if len(cut_up) >= FEWEST else 0
    if every == 0:
        note = "nothing was kept back: the shrinkage is predicted, not measured"
        return _in_blocks(drives, parts), None, "", [*notes, note]
    if len(cut_up) < every:
        what = f"only {len(cut_up)} blocks: too short to keep every {_ordinal(every)} back"
        raise SteerdError(what, "--runs-held-out 0, or name a session", ExitCode.INVALID)
    kept = cut_up[every - 1 :: every]
    fitted = tuple(b for i, b in enumerate(cut_up) if i % every != every - 1)
    return fitted, lambda: kept, f"every {_ordinal(every)} block of the drive", notes


def _ordinal(number: int) -> str:
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ends.get(number % 10, 'th')}"


def cut_blocks(parts: Sequence[Run]) -> tuple[Run, ...]:
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
    return cut_blocks(parts) if len(drives) < EVERY else parts


def _block_notes(drives: Sequence[Run]) -> list[str]:
    if len(drives) >= EVERY:
        return []
    what = "one session" if len(drives) == 1 else f"{len(drives)} sessions"
    return [f"{what}, cut into blocks of {BLOCK:g} s or more: they stand in for further drives"]
