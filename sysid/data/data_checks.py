"""Data checks: unusable drives are refused with the reason and the remedy."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

DURATION_MIN = 1.0  # a drive is at least this long [s]
POSES_MIN = 20
SPAN_MAX = 200.0  # poses that spread further are in millimetres, not metres [m]
TRAVEL_MIN = 0.05  # a car that moved less than this stood still [m]
STEER_SPREAD_MIN = 1e-3  # steering that varies by less is constant [rad]
GAP = 0.2  # gaps longer than this are compared with the distance covered [s]
FROZEN = 1.0  # poses that repeat for this long while the car moves are frozen [s]

_REPEATS = 5  # a pose repeated so often in a row is frozen; one pose and a gap is not
SPEED_MIN = 0.3  # at lower speed a gap in time says nothing about the clock [m/s]
DISTANCE_SHARE_MIN = 0.2
"""Over a gap a car covers at least this share of what its speed before and after would give."""


class DataError(ValueError):
    """Data that cannot be used: `what` is wrong, and as a `hint` what to do about it."""

    def __init__(self, what: str, hint: str) -> None:
        super().__init__(f"{what}; try: {hint}")
        self.what = what
        self.hint = hint


def check_times(name: str, what: str, t: Array) -> None:
    """Refuse times that are not finite or go back.

    Raises:
        DataError: they do.
    """
    if not np.isfinite(t).all():
        raise DataError(f"{name}: a time of {what} is not a number", "check the log's time column")
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        size = t[back[0]] - t[back[0] + 1]
        hint = "the clock was set; split the drive there, or use stamps of a monotonic clock"
        raise DataError(f"{name}: time of {what} goes back by {size:.3g} s", hint)


def check_run(name: str, duration: float, t: Array, pose: Array) -> None:
    """Refuse a drive that is too short, in millimetres, frozen, standing or on a stepping clock.

    Its commands last for `duration` [s]; its poses (M, 3) are of the times `t` [s].

    Raises:
        DataError: it is.
    """
    if duration < DURATION_MIN or len(t) < POSES_MIN:
        what = f"{name}: {max(duration, 0.0):.2f} s of driving with {len(t)} poses"
        raise DataError(what, f"drive at least {DURATION_MIN:g} s in view of the mocap")
    span = np.ptp(pose[:, :2], axis=0).max()
    if span > SPAN_MAX:
        what = f"{name}: poses spread over {span:.0f} m"
        raise DataError(what, "are they in millimetres? set [mocap] units")
    if span < TRAVEL_MIN:
        raise DataError(f"{name}: the car never moved ({span * 1e3:.0f} mm)", "name a drive")
    _check_frozen(name, t, pose)
    _check_clock(name, t, pose)


def _check_frozen(name: str, t: Array, pose: Array) -> None:
    moved = np.any(np.diff(pose, axis=0) != 0.0, axis=1)
    changes = np.concatenate([[0], np.flatnonzero(moved) + 1, [len(t) - 1]])
    stalls = np.where(np.diff(changes) >= _REPEATS, np.diff(t[changes]), 0.0)
    worst = int(np.argmax(stalls))
    if stalls[worst] < FROZEN or worst + 1 >= len(changes) - 1:
        return
    jump = np.linalg.norm(pose[changes[worst + 1], :2] - pose[changes[worst], :2])
    if jump > TRAVEL_MIN:
        what = f"{name}: poses freeze for {stalls[worst]:.1f} s at t = {t[changes[worst]]:.1f} s"
        raise DataError(what, "leave frozen samples out (steerd's mocap checks do)")


def _check_clock(name: str, t: Array, pose: Array) -> None:
    step, moved = np.diff(t), np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1)
    ordinary = step < GAP
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.where(ordinary & (step > 0.0), moved / step, 0.0)
    for i in np.flatnonzero(~ordinary):
        near = speed[max(i - 10, 0) : i + 11]
        near = near[near > 0.0]
        pace = float(np.median(near)) if len(near) else 0.0
        if pace > SPEED_MIN and moved[i] < DISTANCE_SHARE_MIN * pace * step[i]:
            what = f"{name}: {step[i]:.2f} s pass at t = {t[i]:.1f} s, but the car stays in place"
            raise DataError(what, "the clock stepped; split the drive there")


def check_excited(steers: list[Array]) -> None:
    """Refuse drives whose steering is one constant throughout.

    Args:
        steers: commanded angles of each drive [rad].

    Raises:
        DataError: it is.
    """
    if np.ptp(np.concatenate(steers)) < STEER_SPREAD_MIN:
        hint = "drive `steerd collect --plan mixed`"
        raise DataError("steering is one constant throughout", hint)


def noise_of(t: Array, values: Array) -> float:
    """Standard deviation of white noise on a smooth signal, from its third differences.

    The median makes it robust to gaps and outliers. A third difference of white noise has 20 times
    its variance.
    """
    if len(t) < 8:
        return 0.0
    third = np.diff(values, n=3)
    even = np.ptp(np.lib.stride_tricks.sliding_window_view(np.diff(t), 3), axis=1)
    kept = third[even <= 0.5 * np.median(np.diff(t))]
    if not len(kept):
        return 0.0
    return float(1.4826 * np.median(np.abs(kept - np.median(kept))) / np.sqrt(20.0))
