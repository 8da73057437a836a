"""Input of a calibration from a session: body poses, wheel speed, commands and car file."""

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from steerd.car_model.car_file import CarFileError
from steerd.daemon.assembly.session_meta import read_session_car
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.translate import make_car_file_error
from steerd.daemon.sessions.info import Recording, load_recording
from steerd.daemon.settings.config import Settings, load_settings, make_settings
from steerd.daemon.settings.run_options import decode_options
from steerd.daemon.setup.mocap_check import Movement
from steerd.daemon.setup.mount_calibration import Drive
from steerd.mocap_link.frame import FrameConfig, make_planar_pose
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.steer_bus import topics
from steerd.steer_bus.session_read import Session, SessionError
from steerd.steer_bus.topic_columns import Columns


@dataclass(frozen=True)
class Recorded:
    """A session as input of a calibration."""

    settings: Settings  # of the car file that the drive used
    poses: Columns  # columns of the accepted poses, times increasing
    read: Recording  # every topic's columns


def load_recorded(path: Path) -> Recorded:
    """Read a session for calibration. Raises SteerdError: it cannot be read, or lacks poses."""
    read = load_recording(path)
    settings = _read_settings(read.session)
    poses = read.table(topics.MOCAP)
    if poses is None or not (good := poses["reject"] == "").any():
        hint = read.problems[0] if read.problems else "record with `steerd run`"
        raise SteerdError(f"{path} holds no accepted mocap pose", hint)
    kept = {name: column[good] for name, column in poses.items()}
    order = np.argsort(kept["t_valid_ns"], kind="stable")
    order = order[np.diff(kept["t_valid_ns"][order], prepend=0) > 0]
    kept = {name: column[order] for name, column in kept.items()}
    return Recorded(settings, kept, read)


def _read_settings(session: Session) -> Settings:
    """Of the car file that the drive used; F1TENTH's where it holds none."""
    try:
        return make_settings(read_session_car(session))
    except SessionError:
        return load_settings(None)
    except CarFileError as error:
        raise make_car_file_error(error) from None


def load_movement(path: Path) -> tuple[Movement, int]:
    """A session's accepted poses for `check_movement`, and how many were rejected.

    Raises SteerdError: it cannot be read, or lacks poses.
    """
    r = load_recorded(path)
    every = r.read.table(topics.MOCAP)
    columns = (r.poses[name] for name in ("x", "y", "yaw", "height", "tilt"))
    refused = 0 if every is None else int((every["reject"] != "").sum())
    return Movement((r.poses["t_valid_ns"] - r.poses["t_valid_ns"][0]) * 1e-9, *columns), refused


def make_drive(r: Recorded) -> Drive:
    """Poses of the body's own origin and reported speed for `calibrate_mount`.

    Raises SteerdError: the session holds no wheel speed; or it is an imported log, whose poses are
    already those of the car.
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
    frame, start_ns = _frame_without_mount(r), p["t_valid_ns"][0]
    raw = zip(*(p[name].tolist() for name in ("x_raw", "y_raw", "z_raw")), strict=True)
    turns = zip(*(p[name].tolist() for name in ("qw", "qx", "qy", "qz")), strict=True)
    placed = np.array([make_planar_pose(frame, at, q) for at, q in zip(raw, turns, strict=True)])
    x, y, yaw = placed.T[:3]
    t, t_wheel = ((ns - start_ns) * 1e-9 for ns in (p["t_valid_ns"], rolled_ns))
    return Drive(t, x, y, yaw, t_wheel, speed)


def _frame_without_mount(r: Recorded) -> FrameConfig:
    """Room and axes of the drive, without any offset of the body on the car."""
    frame = r.settings.ingest.frame
    about = r.read.info.metadata.get("steerd.session", {})
    with contextlib.suppress(ValueError):
        url = parse_mocap_url(decode_options(about.get("options", "")).mocap or "")
        frame = url.apply(frame)
    return replace(frame, mount_yaw=0.0, marker_rear_x=0.0, marker_rear_y=0.0,
                   cog_ahead_of_rear=0.0)  # fmt: skip
