"""Check motion capture; calibrate the place of its body on the car.

steerd mocap check --mocap natnet://HOST/car     push the car 1 m forward
steerd mocap check DRIVE.mcap
steerd mocap calibrate DRIVE.mcap -o car.toml    from one slow drive

For calibration, drive figures of eight for a minute at two speeds < 1.5 m/s.
"""

import argparse
import sys
from math import degrees, hypot
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import missing_car, missing_session, option
from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.daemon.setup.calibration_data import Recorded
    from steerd.daemon.setup.mocap_check import Check
    from steerd.daemon.setup.mount_calibration import MountCalibration

_ANSWER_S = 4.0
"""A source whose first pose has not come after this has none: a client says so after 3 s [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="check|calibrate")
    check = kinds.add_parser("check", help="units, axes and heading, from a short push or a drive")
    option(check, "session", "SESSION", "", missing_session, nargs="?", type=Path)
    option(check, "--mocap", "URL", "watch this source instead of a session")
    option(check, "--car", "FILE.toml", "with --mocap: car file", missing_car)
    option(check, "--seconds", "S", "with --mocap", type=float, default=10.0)
    calibrate = kinds.add_parser("calibrate", help="heading, place, wheel gain and delay")
    option(calibrate, "session", "SESSION", "", missing_session, type=Path)
    option(calibrate, "-o --output", "CAR.toml", "car file to make", type=Path)
    text = "car file to start from (the session's own)"
    option(calibrate, "--car", "FILE.toml", text, missing_car, type=Path)


def run(args: argparse.Namespace) -> int:
    return _check(args) if args.kind == "check" else _calibrate(args)


# -- check ---------------------------------------------------------------------------------------


def _check(args: argparse.Namespace) -> int:
    if bool(args.session) == bool(args.mocap):
        hint = "steerd mocap check DRIVE.mcap, or steerd mocap check --mocap natnet://HOST/BODY"
        raise SteerdError("name a session or a source", hint, ExitCode.USAGE)
    checks = _check_session(args.session) if args.session else _check_live(args)
    for check in checks:
        print(f"{'pass' if check.ok else 'FAIL'}  {check.name:<8} {check.figure}")
        if not check.ok:
            print(f"      try: {check.fix}")
    return ExitCode.OK if all(check.ok for check in checks) else ExitCode.STOPPED


def _check_session(path: Path) -> "list[Check]":
    from steerd.daemon.setup.calibration_data import load_recorded
    from steerd.daemon.setup.mocap_check import Movement, check_movement
    from steerd.steer_bus import topics

    r = load_recorded(path)
    p, every = r.poses, r.read.table(topics.MOCAP)
    refused = 0 if every is None else int((every["reject"] != "").sum())
    t = (p["t_valid_ns"] - r.start_ns) * 1e-9
    columns = (p[name] for name in ("x", "y", "yaw", "height", "tilt"))
    return check_movement(Movement(t, *columns), refused)


def _check_live(args: argparse.Namespace) -> "list[Check]":
    import numpy as np

    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.settings.config import load_settings
    from steerd.daemon.setup.mocap_check import Movement, check_movement
    from steerd.daemon.setup.probe_ask import listen
    from steerd.mocap_link.mocap_url import parse_mocap_url
    from steerd.mocap_link.sockets import make_receiver
    from steerd.steer_bus.clock import MonotonicClock

    ingest = load_settings(args.car or default_car_path()).ingest
    try:
        receiver = make_receiver(parse_mocap_url(args.mocap), ingest)
    except ValueError as error:
        raise SteerdError(f"--mocap {args.mocap}: {error}", "", ExitCode.USAGE) from None
    except OSError as error:
        raise SteerdError(str(error), "steerd probe", ExitCode.UNREADABLE) from None
    samples, clock = [], MonotonicClock()
    try:
        # Nobody pushes a car for a source that does not answer.
        if next(listen(receiver, clock, _ANSWER_S), None):
            text = f"push the car straight forward by about 1 m within {args.seconds:g} s …"
            print(text, file=sys.stderr, flush=True)
            samples = list(listen(receiver, clock, args.seconds))
    finally:
        receiver.close()
    good = [s for s in samples if s.rejected is None]
    if not good:
        what = f"no pose came from {args.mocap}: {receiver.status().detail}"
        raise SteerdError(what, f"steerd probe --mocap '{args.mocap}'", ExitCode.UNREADABLE)
    t0 = good[0].t_valid_ns
    rows = [((s.t_valid_ns - t0) * 1e-9, s.x, s.y, s.yaw, s.height, s.tilt) for s in good]
    return check_movement(Movement(*np.array(rows).T), len(samples) - len(good))


# -- calibrate -----------------------------------------------------------------------------------


def _calibrate(args: argparse.Namespace) -> int:
    from steerd.car_model.planar import DRIVES
    from steerd.daemon.cli.commands.setup.calibrate import finish, print_found
    from steerd.daemon.common.written import check_outputs
    from steerd.daemon.setup.calibration_data import load_recorded, make_drive
    from steerd.daemon.setup.mount_calibration import calibrate_mount

    check_outputs({"-o": args.output})
    r = load_recorded(args.session)
    file = r.settings.file
    found = calibrate_mount(make_drive(r), file.car, DRIVES.get(file.chassis.drive, 0.0))
    print_found(_describe(found, r), found.warnings)
    then = "steerd run --sim --car {}\n         (on the car: --port and --mocap for --sim)"
    return finish(args, file, new_values(found, r), then)


def new_values(found: "MountCalibration", r: "Recorded") -> dict[tuple[str, str], float]:
    """New values of the car file; a delay within two standard errors of zero becomes zero."""
    m, sd = found.mount, found.sd
    delay = m.delay if m.delay > 2.0 * sd.delay else 0.0
    return {
        ("mocap", "mount_yaw_deg"): round(degrees(m.yaw), 3),
        ("mocap", "marker_rear_x"): round(m.rear_x, 4),
        ("mocap", "marker_rear_y"): round(m.rear_y, 4),
        ("vesc", "erpm_gain"): round(r.settings.scaling.erpm_gain / m.speed_gain, 1),
        ("car", "speed_gain"): 1.0,
        ("car", "pose_delay"): round(delay, 4),
    }


def _describe(found: "MountCalibration", r: "Recorded") -> list[str]:
    m, sd, frame = found.mount, found.sd, r.settings.ingest.frame
    gain = r.settings.scaling.erpm_gain
    moved = hypot(m.rear_x - frame.marker_rear_x, m.rear_y - frame.marker_rear_y)
    return [
        f"from {found.seconds:.0f} s of motion; lateral residual {1e3 * found.residual:.0f} mm/s",
        f"  heading of the body   {degrees(m.yaw):+z.3f}° ± {degrees(sd.yaw):.3f}°"
        f"   (was {degrees(frame.mount_yaw):+z.2f}°)",
        f"  ahead of rear axle    {1e3 * m.rear_x:+.1f} ± {1e3 * sd.rear_x:.1f} mm"
        f"   (was {1e3 * frame.marker_rear_x:+.1f})",
        f"  left of centre line   {1e3 * m.rear_y:+z.1f} ± {1e3 * sd.rear_y:.1f} mm"
        f"   (was {1e3 * frame.marker_rear_y:+.1f}; moved by {1e3 * moved:.0f} in all)",
        f"  ERPM per m/s          {gain / m.speed_gain:.0f} ± {gain * sd.speed_gain:.0f}"
        f"   (was {gain:.0f})",
        f"  delay of the poses    {1e3 * m.delay:+.1f} ± {1e3 * sd.delay:.1f} ms",
    ]
