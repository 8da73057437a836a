"""Paths from files: TUM racelines and F1TENTH track centrelines.

Both are text, a point a line, `#` before comments, columns split by `;` or `,`:

* raceline (TUM global_racetrajectory_optimization), seven columns:
  `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2`;
* centreline (f1tenth_racetracks), four: `x_m, y_m, w_tr_right_m, w_tr_left_m`;
* bare positions, two: `x_m, y_m`.

The path is a cubic spline through the positions, so that place, direction and curvature agree; a
file's own `psi` is a check on it. TUM measures psi from north (the +y axis, so psi = yaw - pi/2);
files made by hand often hold yaw itself. Both are taken, anything else is refused.
"""

import math
from dataclasses import replace
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from steerd.car_model.path.path import Path, place_at_origin

Array = npt.NDArray[np.float64]

STEP = 0.05  # distance aimed at between samples of a path from a file [m]
POINTS_MIN = 5  # fewest points that a cubic spline takes, closed
GAP_CLOSED = 2.5  # a path is closed if its ends lie within this many times the usual spacing
FINE = 20  # spline evaluations per sample, from which arc length is measured
PSI_TOLERANCE = 0.3  # largest median disagreement of a file's psi with its positions [rad]
NORTH = -0.5 * math.pi  # psi minus yaw where psi is measured from the +y axis [rad]
COLUMNS = {
    7: ("s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2"),
    4: ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m"),
    2: ("x_m", "y_m"),
}


class Track(NamedTuple):
    """A file's columns, by name, without a repeated last point."""

    name: str
    columns: dict[str, Array]
    closed: bool

    @property
    def points(self) -> Array:
        """Positions [m], shape (N, 2)."""
        return np.column_stack([self.columns["x_m"], self.columns["y_m"]])


def load_path(file: FilePath, place: str = "start", smooth: float = 0.0) -> Path:
    """The path in `file`.

    Args:
        file: a raceline, centreline or list of positions.
        place: `start` moves the first point to the origin, heading along +x; `as-is` keeps the
            file's coordinates, for a file in the mocap's world.
        smooth: root mean square by which the path may leave the points [m], for noisy ones.

    Raises:
        ValueError: the file cannot be used; says where and why.
        OSError: it cannot be read.
    """
    if place not in ("start", "as-is"):
        raise ValueError(f"place={place}: use place=start or place=as-is")
    path = make_path(read_track(file.read_text(), file.name), smooth)
    return place_at_origin(path) if place == "start" else path


def read_track(text: str, name: str) -> Track:
    """The columns of a path file's text.

    Raises:
        ValueError: a line is not numbers, or the columns are none of the known forms.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.replace(";", ",").split("#", 1)[0].split(",")
        if any(field.strip() for field in fields):
            try:
                rows.append([float(field) for field in fields])
            except ValueError:
                if rows or any(field.strip() == "" for field in fields):
                    raise ValueError(f"{name}, line {number}: not numbers: {line[:60]!r}") from None
    widths = {len(row) for row in rows}
    if len(rows) < POINTS_MIN or len(widths) != 1 or not widths <= COLUMNS.keys():
        raise ValueError(
            f"{name}: {len(rows)} points with {sorted(widths)} columns; a path needs {POINTS_MIN} "
            "points of 7 columns (TUM raceline), 4 (F1TENTH centreline) or 2 (x_m, y_m)"
        )
    table = np.array(rows, dtype=np.float64)
    if not np.isfinite(table).all():
        raise ValueError(f"{name}: a value is not finite")
    return _drop_repeats(name, table, COLUMNS[table.shape[1]])


def _drop_repeats(name: str, table: Array, names: tuple[str, ...]) -> Track:
    """The table without repeated points, and whether its ends meet."""
    at = [names.index("x_m"), names.index("y_m")]
    gaps = np.linalg.norm(np.diff(table[:, at], axis=0), axis=1)
    usual = float(np.median(gaps))
    if usual == 0.0:
        raise ValueError(f"{name}: its points do not move")
    table = table[np.concatenate([[True], gaps > 1e-3 * usual])]
    end_gap = float(np.linalg.norm(table[-1, at] - table[0, at]))
    if end_gap <= 1e-3 * usual:
        table = table[:-1]
    if len(table) < POINTS_MIN:
        raise ValueError(f"{name}: fewer than {POINTS_MIN} different points")
    columns = {column: table[:, i] for i, column in enumerate(names)}
    return Track(name, columns, end_gap <= GAP_CLOSED * usual)


def make_path(track: Track, smooth: float = 0.0) -> Path:
    """Equal steps along a cubic spline through a track's points (see `load_path`).

    Raises:
        ValueError: the file's psi contradicts its positions, or `smooth` is negative.
    """
    # A third of a second to import, and few paths come from files.
    from scipy.interpolate import splev, splprep

    if smooth < 0.0:
        raise ValueError(f"smooth={smooth}: give a distance in metres, 0 for none")
    points = track.points
    if track.closed:
        points = np.concatenate([points, points[:1]])
    chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline, _ = splprep(points.T, u=chords, k=3, per=track.closed, s=len(points) * smooth * smooth)
    at, step = _equal_steps(spline, float(chords[-1]), track.closed)
    (x, y), (dx, dy), (ddx, ddy) = (np.asarray(splev(at, spline, der=n)) for n in range(3))
    yaw = np.unwrap(np.arctan2(dy, dx))
    _check_psi(track, chords, at, yaw)
    curvature = (dx * ddy - dy * ddx) / (dx * dx + dy * dy) ** 1.5
    columns = (tuple(column.tolist()) for column in (x, y, yaw, curvature))
    speed = _column(track, "vx_mps", chords, at)
    left, right = (_column(track, f"w_tr_{side}_m", chords, at) for side in ("left", "right"))
    path = Path(track.name, step, track.closed, *columns)
    return replace(path, speed=speed, width_left=left, width_right=right)


def _equal_steps(spline: object, end: float, closed: bool) -> tuple[Array, float]:
    """Spline parameters at equal arc lengths, and that length."""
    from scipy.interpolate import splev

    fine = np.linspace(0.0, end, FINE * max(8, round(end / STEP)) + 1)
    pace = np.hypot(*splev(fine, spline, der=1))
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.diff(fine))])
    intervals = max(8, round(float(arc[-1]) / STEP))
    step = float(arc[-1]) / intervals
    places = step * np.arange(intervals if closed else intervals + 1)
    return np.interp(places, arc, fine), step


def _check_psi(track: Track, chords: Array, at: Array, yaw: Array) -> None:
    """Refuses a file whose psi is neither yaw nor yaw - pi/2 along its positions."""
    psi = track.columns.get("psi_rad")
    if psi is None:
        return
    turn = psi - np.interp(chords[: len(psi)], at, yaw)
    misfit = {
        offset: float(np.median(np.abs(np.angle(np.exp(1j * (turn - offset))))))
        for offset in (NORTH, 0.0)
    }
    if min(misfit.values()) > PSI_TOLERANCE:
        raise ValueError(
            f"{track.name}: psi_rad disagrees with the positions by {misfit[NORTH]:.2f} rad taken "
            f"from +y (TUM) and {misfit[0.0]:.2f} rad taken from +x; are the columns in order "
            "s, x, y, psi, kappa, vx, ax, or the points reversed?"
        )


def _column(track: Track, name: str, chords: Array, at: Array) -> tuple[float, ...] | None:
    """A column at the samples, linear between points; None where the file has none."""
    values = track.columns.get(name)
    if values is None:
        return None
    whole = np.concatenate([values, values[:1]]) if track.closed else values
    return tuple(np.interp(at, chords, whole).tolist())
