"""Check motion capture; calibrate the place of its body on the car.

steerd mocap check --mocap natnet://HOST/car     push the car 1 m forward
steerd mocap check DRIVE.mcap
steerd mocap calibrate DRIVE.mcap -o car.toml    from one slow drive

For calibration, drive figures of eight for a minute at two speeds < 1.5 m/s.
"""

import argparse
from pathlib import Path

from steerd.daemon.cli.arguments import missing_car, missing_session, option
from steerd.daemon.common.errors import ExitCode, SteerdError


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


def run(args: argparse.Namespace) -> int | None:
    if args.kind == "check":
        return _check(args)
    _calibrate(args)
    return None


def _check(args: argparse.Namespace) -> int:
    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.settings.config import load_settings
    from steerd.daemon.setup.calibration_data import load_movement
    from steerd.daemon.setup.mocap_check import check_movement
    from steerd.daemon.setup.probe_ask import watch_movement

    if bool(args.session) == bool(args.mocap):
        hint = "steerd mocap check DRIVE.mcap, or steerd mocap check --mocap natnet://HOST/BODY"
        raise SteerdError("name a session or a source", hint, ExitCode.USAGE)
    if args.session:
        checks = check_movement(*load_movement(args.session))
    else:
        ingest = load_settings(args.car or default_car_path()).ingest
        checks = check_movement(*watch_movement(args.mocap, ingest, args.seconds))
    for check in checks:
        print(f"{'pass' if check.ok else 'FAIL'}  {check.name:<8} {check.figure}")
        if not check.ok:
            print(f"      try: {check.fix}")
    return ExitCode.OK if all(check.ok for check in checks) else ExitCode.STOPPED


def _calibrate(args: argparse.Namespace) -> None:
    from steerd.car_model.planar import DRIVES
    from steerd.daemon.cli.commands.setup.calibrate import finish, print_found
    from steerd.daemon.common.written import check_outputs
    from steerd.daemon.setup import mount_calibration as mount
    from steerd.daemon.setup.calibration_data import load_recorded, make_drive

    check_outputs({"-o": args.output})
    r = load_recorded(args.session)
    file, gain = r.settings.file, r.settings.scaling.erpm_gain
    front = DRIVES.get(file.chassis.drive, 0.0)
    found = mount.calibrate_mount(make_drive(r), file.car, front)
    print_found(mount.describe_mount(found, r.settings.ingest.frame, gain), found.warnings)
    then = "steerd run --sim --car {}\n         (on the car: --port and --mocap for --sim)"
    finish(args, file, mount.mount_values(found, gain), then)
