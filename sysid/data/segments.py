"""Segments of drives in which the car moves, and blocks that are held out for validation.

Below walking pace motor controllers do not follow a speed, and the yaw mode is so stiff that the
smallest step would be needed throughout; backwards a car is another one. A fit uses the rest. Times
within a segment count from its first command. The commands of the half second before it
(`Run.history`) belong to it, whatever the car did then, so that the steering's past is known.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from math import floor
from typing import Any

import numpy as np

from steerd.car_model.chassis import SPEED_KINEMATIC
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import HISTORY, Run, Signal, least_pause, pose_rates

SPEED_MIN = 0.4  # speed of a segment, at least [m/s] ...
SPEED_ROLLS = SPEED_KINEMATIC
"""... and where it was measured, so that no motor controller has to follow it: below this a car
follows its wheels, whatever its tyres."""
DURATION_MIN = 1.2  # shorter stretches are left out [s]: a window and what its ends need
SHORT_REPORTED = 0.5  # shorter ones are starts and stops, and nobody misses them [s]
SMOOTH = 0.3  # width of the Hann window that smooths a prescribed speed [s]
BLOCK = 5.4  # length of the blocks of which every k-th is held out [s]
PIECE = 30.0  # length of the pieces that stand for a long drive [s]
_ROUNDED = 1.0 + 1e-9
MEASURED, ORDERED = ("pose", "wheel", "yaw_rate"), ("steer", "speed_command")
"""Signals of a drive, with times."""


def make_segment(run: Run, low: float, high: float) -> Run:
    """The segment of a drive between two times [s].

    Commands begin up to the run's `history` earlier; measurements lie in [low, high].
    """
    first = max(0, round((low - run.history) / run.h))
    last = min(len(run.commands), round(high / run.h))
    zero = first * run.h

    def part(signal: Signal, since: float) -> Signal:
        inside = (signal.t >= since - 1e-9) & (signal.t <= high + 1e-9)
        return Signal(signal.t[inside] - zero, signal.values[inside])

    parts: dict[str, Any] = {name: part(getattr(run, name), low) for name in MEASURED}
    for name in ORDERED:
        t = getattr(run, name).t
        parts[name] = part(getattr(run, name), t[t <= zero + 1e-9].max(initial=0.0))
    return replace(run, commands=run.commands[first:last], start=run.start + zero, **parts)


def spread_evenly(run: Run, most: float, lead: float) -> list[Run]:
    """Pieces of a drive, evenly from where the car moves; the drive itself where that is short.

    They last for `most` [s] in all; `lead` [s] of the commands before each belong to it.
    """
    spans = _spans(run)
    driven = sum(high - low for low, high in spans)
    if driven <= most:
        return [run]
    pieces = [
        (float(begin), min(float(begin) + PIECE, high))
        for low, high in spans
        for begin in np.arange(low, high, PIECE)
    ]
    count = max(1, round(len(pieces) * most / driven))
    chosen = np.linspace(0, len(pieces) - 1, count).round().astype(int)
    longer = replace(run, history=max(lead, run.history))
    cut = [make_segment(longer, *pieces[i]) for i in chosen]
    # Commands of their own: a view would keep the whole drive in memory.
    return [replace(p, history=run.history, commands=p.commands.copy()) for p in cut]


def thinned(runs: Sequence[Run], most: float) -> list[Run]:
    """As many of the drives, evenly chosen, as last no longer than `most` in all [s]."""
    count = len(runs)
    while count > 1:
        chosen = np.linspace(0, len(runs) - 1, count).round().astype(int)
        driven = sum(runs[i].driven for i in chosen)
        if driven <= most * _ROUNDED:
            return [runs[i] for i in chosen]
        count = min(count - 1, int(count * most / driven))
    return list(runs[:1])


def with_wheel_speed(run: Run) -> Run:
    """The drive with its measured wheel speed in place of the command, which it did not follow.

    Raises:
        DataError: no wheel speed was recorded.
    """
    if len(run.wheel.t) < 2:
        raise DataError(f"{run.name}: no wheel speed was recorded", "drop --speed wheel")
    ends = run.h * np.arange(1, len(run.commands) + 1)
    speed = np.interp(ends, *run.wheel)
    return replace(run, commands=np.column_stack([run.commands[:, 0], speed]), speed_source="wheel")


def smooth_speed(run: Run) -> Run:
    """The drive with a prescribed speed smoothed over `SMOOTH` seconds.

    Where the speed is prescribed, its slope is the acceleration that shifts load between the axles;
    the derivative of an encoder's steps would be far too large.
    """
    if run.speed_source == "command":
        return run
    half = round(0.5 * SMOOTH / run.h)
    padded = np.pad(run.commands[:, 1], half, "edge")
    window = np.hanning(2 * half + 3)[1:-1]
    speed = np.convolve(padded, window / window.sum(), "valid")
    return replace(run, commands=np.column_stack([run.commands[:, 0], speed]))


def _spans(run: Run) -> list[tuple[float, float]]:
    """Stretches in which command and pose both say that the car goes forward [s]."""
    t, speed, _ = pose_rates(run.pose)
    grid = run.h * np.arange(len(run.commands))
    slow = np.convolve(np.interp(grid, t, speed), np.ones(11) / 11.0, "same")
    least = SPEED_MIN if run.speed_source == "command" else SPEED_ROLLS
    moving = (run.commands[:, 1] > least) & (slow > least)
    moving &= (grid >= run.pose.t[0]) & (grid <= run.pose.t[-1])
    for first, last in pauses(run):
        moving &= (grid <= first) | (grid >= last)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]]).astype(int)))
    return [(a * run.h, b * run.h) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def pauses(run: Run) -> list[tuple[float, float]]:
    """Stretches without poses: last pose before and first after each [s]."""
    places = np.flatnonzero(np.diff(run.pose.t) > least_pause(run.pose.t))
    return [(float(run.pose.t[i]), float(run.pose.t[i + 1])) for i in places]


def describe_unused(runs: Sequence[Run]) -> tuple[str, ...]:
    """What of the driving `moving_segments` leaves out without being asked to, in words."""
    texts = []
    lengths = [high - low for run in runs for low, high in _spans(run)]
    short = [n for n in lengths if SHORT_REPORTED < n < DURATION_MIN]
    if short:
        texts.append(
            f"{len(short)} stretch{'es' * (len(short) > 1)} of driving shorter than "
            f"{DURATION_MIN:g} s, {sum(short):.0f} s of {sum(lengths):.0f} s in all, "
            "not used: what a car does then depends on how it began"
        )
    for run in runs:
        where = [f"{first:.2f} s to {last:.2f} s" for first, last in pauses(run)]
        if where:
            more = f" and {len(where) - 1} times more" if len(where) > 1 else ""
            texts.append(f"{run.name}: no poses from {where[0]}{more}; the drive is cut there")
    return tuple(texts)


def moving_segments(runs: Sequence[Run]) -> tuple[Run, ...]:
    """The segments of drives in which the car moves.

    Raises:
        DataError: there is none.
    """
    segments = [
        make_segment(run, low + min(HISTORY, high - low - DURATION_MIN), high)
        for run in map(smooth_speed, runs)
        for low, high in _spans(run)
        if high - low >= DURATION_MIN
    ]
    if not segments:
        names = ", ".join(run.name for run in runs)
        what = f"{names}: no {DURATION_MIN:g} s without a stop at more than {SPEED_MIN:g} m/s"
        raise DataError(what, "drive `steerd collect --plan mixed`")
    return tuple(segments)


def make_blocks(
    parts: Sequence[Run],
    length: float = BLOCK,
    count: Callable[[float], int] = round,
    over: float = np.inf,
) -> tuple[Run, ...]:
    """Segments split into blocks of about one length [s]; no measurement is in two of them.

    No model of a real car predicts a minute: over long windows its errors accumulate. `count` makes
    a whole number of blocks; `int` makes them no shorter. They may be longer than whole seconds by
    `over` [s]; what goes beyond is left out.
    """
    found: list[Run] = []
    for part in parts:
        start, end = float(part.pose.t[0]), min(float(part.pose.t[-1]), part.duration)
        edges = np.linspace(start, end, max(1, count((end - start) / length)) + 1)
        for low, high in pairwise(edges.tolist()):
            last = min(high - 1e-6, low + max(1, floor(high - low)) + over)
            found.append(make_segment(part, low, last))
    return tuple(found)


def split_every(parts: Sequence[Run], every: int) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """All but every k-th part, and those."""
    held_out = tuple(parts[every - 1 :: every])
    return tuple(part for i, part in enumerate(parts) if i % every != every - 1), held_out


def hold_out(parts: Sequence[Run], every: int) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """Blocks of segments to fit, and every k-th one to validate with.

    Raises:
        DataError: the drives are too short to hold anything out.
    """
    blocks = make_blocks(parts)
    fitted, held_out = split_every(blocks, every)
    if not held_out or not fitted:
        count = len(blocks)
        only = f"only {count} block{'s' * (count != 1)} of {BLOCK:g} s"
        what = f"{only}: too short to hold every {every}th out"
        raise DataError(what, "record more drives, or name one with --held-out FILE")
    return fitted, held_out
