"""Is the room set up right? What a car that is pushed or driven a metre tells about axes and units.

Pure. The gates look at single poses; these checks look at a movement.
"""

from dataclasses import dataclass
from math import degrees, pi

import numpy as np

from steerd.daemon.sessions.motion import GAP_MAX, Array

STEP = 0.05
"""Directions are taken over so much way [m]."""
WAY_MIN, WAY_MAX = 0.5, 2000.0
HEIGHT_MAX = 0.01
TILT_MAX = 0.08
TRAVEL_MAX = 0.09
"""Between travel and heading on a straight [rad]: 5 degrees."""
STRAIGHT = 0.05
"""A step is straight if it turns by less [rad]."""


@dataclass(frozen=True)
class Movement:
    """Accepted poses of a car that moved, in time's order [s, m, m, rad, m, rad]."""

    t: Array
    x: Array
    y: Array
    yaw: Array
    height: Array
    tilt: Array


@dataclass(frozen=True)
class Check:
    """One question and its answer; `fix` is empty where all is well."""

    name: str
    ok: bool
    figure: str
    fix: str = ""


def check_movement(m: Movement, refused: int) -> list[Check]:
    """All checks, in the order in which they should be put right.

    Args:
        m: accepted poses.
        refused: how many poses the gates refused.
    """
    way = np.hypot(np.diff(m.x), np.diff(m.y))
    length = float(np.sum(way)) if len(way) else 0.0
    checks = [_stream(m, refused), _way(m, length)]
    if not checks[-1].ok:
        return checks
    checks += [_height(m), _tilt(m)]
    at = np.concatenate(([0.0], np.cumsum(np.maximum(way, 1e-9))))
    steps = np.arange(0.0, at[-1], STEP)
    x, y, yaw = (np.interp(steps, at, column) for column in (m.x, m.y, np.unwrap(m.yaw)))
    travel, turn = np.arctan2(np.diff(y), np.diff(x)), np.diff(yaw)
    return [*checks, *_heading(travel, yaw[:-1] + turn / 2, turn)]


def _stream(m: Movement, refused: int) -> Check:
    total = len(m.t) + refused
    gap = float(np.max(np.diff(m.t))) if len(m.t) > 1 else np.inf
    rate = 1.0 / float(np.median(np.diff(m.t))) if len(m.t) > 1 else 0.0
    ok = refused <= 0.02 * total and gap < GAP_MAX
    figure = f"{rate:.0f} Hz, {refused} of {total} refused, longest gap {1e3 * gap:.0f} ms"
    fix = "`steerd probe --mocap URL` says which check refuses them and what to do"
    return Check("stream", ok, figure, "" if ok else fix)


def _way(m: Movement, length: float) -> Check:
    extent = float(max(np.ptp(m.x), np.ptp(m.y))) if len(m.x) else 0.0
    figure = f"{length:.2f} m of way, {extent:.2f} m across"
    if extent < WAY_MIN:
        return Check("way", False, figure, "push the car straight forward by about 1 m")
    if extent > WAY_MAX or length > 50.0 * extent + 50.0:
        return Check("way", False, figure, "millimetres taken for metres? set [mocap] units")
    return Check("way", True, figure)


def _height(m: Movement) -> Check:
    span = float(np.quantile(m.height, 0.98) - np.quantile(m.height, 0.02))
    extent = float(max(np.ptp(m.x), np.ptp(m.y)))
    # A floor 1 % off level is common; a wrong up axis moves the height as far as the car.
    ok = span < HEIGHT_MAX + 0.01 * extent
    fix = "set [mocap] up (y or z) to the server's up axis; set the ground plane if it leans"
    return Check("height", ok, f"varies by {1e3 * span:.0f} mm", "" if ok else fix)


def _tilt(m: Movement) -> Check:
    tilt = float(np.median(m.tilt))
    fix = "reset the body's orientation in the mocap software with the car on the floor"
    return Check("level", tilt < TILT_MAX, f"leans {degrees(tilt):.1f}°",
                 "" if tilt < TILT_MAX else fix)  # fmt: skip


def _heading(travel: Array, yaw: Array, turn: Array) -> list[Check]:
    straight = np.abs(turn) < STRAIGHT
    if straight.sum() < 5:
        return [Check("heading", False, "no straight stretch", "push the car straight forward")]
    off = float(np.angle(np.mean(np.exp(1j * (travel - yaw)[straight]))))
    figure = f"{degrees(off):+.1f}° between travel and heading"
    checks = [Check("heading", abs(off) < TRAVEL_MAX, figure, _fix_heading(off))]
    bend = np.angle(np.exp(1j * np.diff(travel)))
    turned = float(np.sum(np.abs(turn)))
    if turned > 0.5:
        slope = float(np.sum(bend * turn[1:]) / np.sum(turn[1:] ** 2))
        fix = "the world is mirrored: is [mocap] up right, are the axes right-handed?"
        ok = slope > 0.3
        figure = f"yaw follows the path's turns by {slope:+.2f}"
        checks.append(Check("turning", ok, figure, "" if ok else fix))
    return checks


def _fix_heading(off: float) -> str:
    if abs(off) < TRAVEL_MAX:
        return ""
    if abs(off) < 0.5:
        return "`steerd mocap calibrate` finds [mocap] mount_yaw_deg"
    quarter = round(off / (pi / 2)) * 90
    return (
        f"the body's axis [mocap] body_forward points {abs(quarter)}° to the "
        f"{'right' if quarter > 0 else 'left'} of the travel: name the axis that points ahead"
        if abs(quarter) == 90
        else "pushed backwards? else turn [mocap] body_forward round"
    )
