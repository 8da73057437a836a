"""What both calibrations use: a session's poses, wheel speed and car file, and least squares."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from steerd.car_model.car_file import CarFileError
from steerd.daemon.assembly.session_meta import read_session_car
from steerd.daemon.common.errors import SteerdError, make_car_file_error
from steerd.daemon.sessions.info import Recording, load_recording
from steerd.daemon.settings.config import Settings, load_settings, make_settings
from steerd.daemon.settings.run_options import recorded_options
from steerd.daemon.setup.mocap_check import Movement
from steerd.mocap_link.frame import make_planar_pose
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.steer_bus import topics
from steerd.steer_bus.session_read import SessionError
from steerd.steer_bus.topic_columns import Columns
from steerd.sysid.data.data_checks import Array


@dataclass(frozen=True)
class Recorded:
    """A session as input of a calibration."""

    settings: Settings  # of the car file that the drive used
    poses: Columns  # columns of the accepted poses, times increasing
    refused: int  # number of the others
    read: Recording  # every topic's columns


@dataclass(frozen=True)
class Drive:
    """Body poses in the room (no offsets applied) and wheel speed."""

    t: Array  # of the body's origin and forward axis [s, m, m, rad]
    x: Array
    y: Array
    yaw: Array
    t_wheel: Array  # reported speed [s, m/s]
    wheel: Array


def load_recorded(path: Path) -> Recorded:
    """Read a session for calibration; a SteerdError where it cannot be read, or lacks poses."""
    read = load_recording(path)
    try:
        settings = make_settings(read_session_car(read.session))
    except SessionError:  # it holds no car file
        settings = load_settings(None)
    except CarFileError as error:
        raise make_car_file_error(error) from None
    poses = read.table(topics.MOCAP)
    if poses is None or not (good := poses["reject"] == "").any():
        hint = read.problems[0] if read.problems else "record with `steerd run`"
        raise SteerdError(f"{path} holds no accepted mocap pose", hint)
    kept = {name: column[good] for name, column in poses.items()}
    order = np.argsort(kept["t_valid_ns"], kind="stable")
    order = order[np.diff(kept["t_valid_ns"][order], prepend=0) > 0]
    kept = {name: column[order] for name, column in kept.items()}
    return Recorded(settings, kept, int((~good).sum()), read)


def load_movement(path: Path) -> tuple[Movement, int]:
    """A session's accepted poses, see `load_recorded`, and how many were rejected."""
    r = load_recorded(path)
    columns = (r.poses[name] for name in ("x", "y", "yaw", "height", "tilt"))
    t = (r.poses["t_valid_ns"] - r.poses["t_valid_ns"][0]) * 1e-9
    return Movement(t, *columns), r.refused


def make_drive(r: Recorded) -> Drive:
    """Poses of the body's own origin and reported speed for `calibrate_mount`.

    A SteerdError without wheel speed, or for an imported log, whose poses are the car's already.
    """
    p, vesc, wheel = r.poses, r.read.table(topics.VESC), r.read.table(topics.WHEEL)
    if not np.isfinite(p["z_raw"]).all():
        hint = "for an imported log, set the offsets in its map's [frame]"
        raise SteerdError("the session holds the car's poses only, not its body's", hint)
    if vesc is not None:
        rolled_ns = (vesc["t_sent_ns"] + vesc["t_received_ns"]) // 2
        scaling = r.settings.scaling
        speed = (vesc["erpm"].astype(float) - scaling.erpm_offset) / scaling.erpm_gain
    elif wheel is not None:
        rolled_ns, speed = wheel["t_ns"], wheel["speed"].astype(float)
    else:
        raise SteerdError("the session holds no wheel speed")
    frame, start_ns = r.settings.ingest.frame, p["t_valid_ns"][0]
    options = recorded_options(r.read.info.metadata)
    with suppress(ValueError):  # an address of another version
        frame = parse_mocap_url((options and options.mocap) or "").apply(frame)
    frame = replace(frame, mount_yaw=0.0, marker_rear_x=0.0, marker_rear_y=0.0,
                    cog_ahead_of_rear=0.0)  # fmt: skip
    raw = zip(*(p[name].tolist() for name in ("x_raw", "y_raw", "z_raw")), strict=True)
    turns = zip(*(p[name].tolist() for name in ("qw", "qx", "qy", "qz")), strict=True)
    placed = np.array([make_planar_pose(frame, at, q) for at, q in zip(raw, turns, strict=True)])
    x, y, yaw = placed.T[:3]
    t, t_wheel = ((ns - start_ns) * 1e-9 for ns in (p["t_valid_ns"], rolled_ns))
    return Drive(t, x, y, yaw, t_wheel, speed)


# -- least squares, jackknife errors and delays ----------------------------------------------------

Mask = NDArray[np.bool_]

MOVING = 0.2  # slower motion is mostly noise [m/s]
BLOCKS = 10  # contiguous blocks left out in turn (delete-a-group jackknife)
DELAY_LOW, DELAY_HIGH, DELAY_STEP = -0.05, 0.25, 0.01  # range and grid of the delay search [s]
LATERAL_ACCEL_MAX = 2.0  # above this the tyres' slip is no longer small [m/s^2]


def solve_least_squares(rows: Array, values: Array) -> tuple[Array, Array]:
    """Solve `rows @ x = values`, shapes (n, k) and (n,), by least squares: x and the residuals."""
    solution = np.linalg.lstsq(rows, values, rcond=None)[0]
    return np.asarray(solution, dtype=np.float64), values - rows @ solution


def jackknife_sd(
    good: Mask, estimate: Callable[[Mask], Array | Sequence[float]]
) -> tuple[float, ...]:
    """Standard errors: of estimates without each block of the good samples, shape (n,), in turn."""
    parts = []
    for block in np.array_split(np.flatnonzero(good), BLOCKS):
        mask = good.copy()
        mask[block] = False
        parts.append(estimate(mask))
    return tuple((np.sqrt(BLOCKS - 1) * np.std(np.array(parts), axis=0)).tolist())


def find_delay(cost: Callable[[float], float]) -> float:
    """The delay of least cost [s]: the best of a grid, refined."""
    grid = np.arange(DELAY_LOW, DELAY_HIGH, DELAY_STEP)
    at = float(grid[int(np.argmin([cost(float(tau)) for tau in grid]))])
    found = minimize_scalar(cost, bounds=(at - DELAY_STEP, at + DELAY_STEP), method="bounded")
    return float(found.x)


def find_slip_warnings(lateral: Array) -> list[str]:
    """Warnings about a drive with these lateral accelerations [m/s^2], shape (n,)."""
    if float(np.quantile(np.abs(lateral), 0.95)) <= LATERAL_ACCEL_MAX:
        return []
    limit = f"{LATERAL_ACCEL_MAX:g} m/s²"
    return [f"it corners with more than {limit}: tyre slip biases the result, drive slower"]
