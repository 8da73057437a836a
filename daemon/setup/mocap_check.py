"""Checks of mocap units, axes and heading from a car that is pushed or driven for a metre.

Pure. Ingest checks single poses; these checks look at a movement.
"""

from dataclasses import dataclass
from math import degrees, pi

import numpy as np

from steerd.daemon.sessions.motion import GAP_MAX
from steerd.sysid.data.data_checks import Array

STEP = 0.05  # directions are taken over this distance [m]
EXTENT_MIN, EXTENT_MAX = 0.5, 2000.0
"""A smaller movement decides nothing; a larger one is in millimetres [m]."""
LAPS_MAX = 50.0  # distance per extent plus one metre; noise of poses in millimetres gives more [-]
REJECTED_MAX = 0.02  # share of rejected poses that is still good [-]
HEIGHT_MAX = 0.01  # the height may vary by this, and by 1 % of the extent [m]
TILT_MAX = 0.08  # largest tilt of the body on a level floor [rad]: 5 degrees
TRAVEL_MAX = 0.09  # between travel and heading on a straight [rad]: 5 degrees
MOUNT_MAX = 0.5  # a smaller angle is calibrated, a larger one is another axis [rad]
TURNED_MIN = 0.5  # a smaller change of heading says nothing about its sign [rad]
STRAIGHT = 0.05  # a step is straight if it turns by less [rad]


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
    """One check and its result; `fix` is what to do where it fails."""

    name: str
    ok: bool
    figure: str
    fix: str = ""


def check_movement(m: Movement, refused: int) -> list[Check]:
    """All checks, in the order in which failures should be fixed; so many poses were `refused`."""
    steps = np.hypot(np.diff(m.x), np.diff(m.y))
    length, extent = float(np.sum(steps)), float(max(np.ptp(m.x), np.ptp(m.y)))
    checks = [_check_stream(m, refused), _check_distance(extent, length)]
    if not checks[-1].ok:
        return checks
    span = float(np.quantile(m.height, 0.98) - np.quantile(m.height, 0.02))
    # A floor that is 1 % off level is common; a wrong up axis moves the height as far as the car.
    level = span < HEIGHT_MAX + 0.01 * extent
    fix = "set [mocap] up (y or z) to the server's up axis; set the ground plane if it leans"
    checks.append(Check("height", level, f"varies by {1e3 * span:.0f} mm", fix))
    tilt = float(np.median(m.tilt))
    fix = "reset the body's orientation in the mocap software with the car on the floor"
    checks.append(Check("level", tilt < TILT_MAX, f"leans {degrees(tilt):.1f}°", fix))
    at = np.concatenate(([0.0], np.cumsum(np.maximum(steps, 1e-9))))
    even = np.arange(0.0, at[-1], STEP)
    x, y, yaw = (np.interp(even, at, column) for column in (m.x, m.y, np.unwrap(m.yaw)))
    travel, turn = np.arctan2(np.diff(y), np.diff(x)), np.diff(yaw)
    return [*checks, *_check_heading(travel, yaw[:-1] + turn / 2, turn)]


def _check_stream(m: Movement, refused: int) -> Check:
    total = len(m.t) + refused
    gap = float(np.max(np.diff(m.t))) if len(m.t) > 1 else np.inf
    rate = 1.0 / float(np.median(np.diff(m.t))) if len(m.t) > 1 else 0.0
    ok = refused <= REJECTED_MAX * total and gap < GAP_MAX
    figure = f"{rate:.0f} Hz, {refused} of {total} rejected, longest gap {1e3 * gap:.0f} ms"
    fix = "`steerd probe --mocap URL` shows which check rejects them and what to do"
    return Check("stream", ok, figure, fix)


def _check_distance(extent: float, length: float) -> Check:
    figure = f"{extent:.2f} m from end to end, {length:.2f} m of path"
    if extent < EXTENT_MIN:  # the path of a car that stands is the noise of its poses
        fix = "push the car straight forward by about 1 m"
        return Check("distance", False, f"moved by {extent:.2f} m", fix)
    if extent > EXTENT_MAX or length > LAPS_MAX * (extent + 1.0):
        return Check("distance", False, figure, "millimetres taken for metres? set [mocap] units")
    return Check("distance", True, figure)


def _check_heading(travel: Array, yaw: Array, turn: Array) -> list[Check]:
    straight = np.abs(turn) < STRAIGHT
    if straight.sum() < 5:
        return [Check("heading", False, "no straight stretch", "push the car straight forward")]
    off = float(np.angle(np.mean(np.exp(1j * (travel - yaw)[straight]))))
    figure = f"{degrees(off):+.1f}° between travel and heading"
    checks = [Check("heading", abs(off) < TRAVEL_MAX, figure, _fix_heading(off))]
    bend = np.angle(np.exp(1j * np.diff(travel)))
    turned = float(np.sum(np.abs(turn)))
    if turned > TURNED_MIN:
        slope = float(np.sum(bend * turn[1:]) / np.sum(turn[1:] ** 2))
        fix = "the world is mirrored: is [mocap] up right, are the axes right-handed?"
        figure = f"yaw follows the path's turns by {slope:+.2f}"
        checks.append(Check("turning", slope > 0.3, figure, fix))
    return checks


def _fix_heading(off: float) -> str:
    if abs(off) < MOUNT_MAX:
        return "`steerd mocap calibrate` finds [mocap] mount_yaw_deg"
    quarter = round(off / (pi / 2)) * 90
    return (
        f"the body's axis [mocap] body_forward points {abs(quarter)}° to the "
        f"{'right' if quarter > 0 else 'left'} of the travel: name the axis that points ahead"
        if abs(quarter) == 90
        else "pushed backwards? else turn [mocap] body_forward round"
    )
