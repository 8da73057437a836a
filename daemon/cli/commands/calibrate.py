"""Commands that check mocap, and calibrate the place of its body and the steering."""

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from steerd.car_model.car_file import CarFile
from steerd.daemon.cli.arguments import missing_car, missing_session, option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, load_car_file
from steerd.daemon.common.screen import print_warnings
from steerd.daemon.common.written import car_outputs, check_outputs, write_outputs
from steerd.daemon.settings.car_edit import Values, edit_car
from steerd.daemon.settings.config import load_settings
from steerd.steer_bus.clock import MonotonicClock
from steerd.vesc_link.scaling import Scaling


def calibrate_arguments(parser: ArgumentParser) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="servo")
    servo = kinds.add_parser("servo", help="centre, gain and limits of the steering")
    option(servo, "session", "SESSION", "", missing_session, nargs="?", type=Path)
    option(servo, "--port", "DEV", "move the servo of this VESC by the keys")
    option(servo, "--car", "FILE.toml", "car file to start from", missing_car, type=Path)
    option(servo, "-o --output", "CAR.toml", "car file to make", type=Path)


def calibrate(args: Namespace) -> int | None:
    """Calibrate the steering's centre, gain and limits, from a session or by keys.

    steerd calibrate servo DRIVE.mcap -o car.toml
    steerd calibrate servo --port /dev/ttyACM0 --car car.toml -o car.toml

    With --port only the servo moves, never the motor; lift the front wheels. Arrow
    keys steer; set the centre, the left and the right stop where the servo is.
    """
    if bool(args.session) == bool(args.port):
        hint = "steerd calibrate servo DRIVE.mcap, or steerd calibrate servo --port DEV"
        raise UsageError("name a session or a port", hint)
    check_outputs({"-o": args.output})
    scaling: Scaling | None
    if args.port:
        from steerd.daemon.terminal.servo_keys import steer_by_keys

        settings = load_settings(args.car)
        print("only the servo moves; lift the front wheels", file=sys.stderr)
        file, scaling = settings.file, steer_by_keys(args.port, settings.scaling, MonotonicClock())
    else:
        file, scaling = _from_session(args.session)
    if scaling is None:
        print("nothing was changed")
        return ExitCode.INTERRUPTED
    names = ("servo_gain", "servo_offset", "servo_min", "servo_max")
    values = {("vesc", name): round(float(getattr(scaling, name)), 4) for name in names}
    own = {("car", "steer_gain"): 1.0, ("car", "steer_bias"): 0.0}  # the servo's now
    finish(args, file, values | own, "steerd config --check {}")
    return None


def _from_session(path: Path) -> tuple[CarFile, Scaling]:
    from steerd.daemon.setup import steering_calibration as steering
    from steerd.daemon.setup.calibration_data import load_recorded
    from steerd.steer_bus import topics

    r = load_recorded(path)
    track, steer = r.read.track, r.read.signal(topics.ACTUATION, "steer")
    if track is None or steer is None:
        missing = "steering commands" if track else "motion"
        raise SteerdError(f"the session holds no {missing}", "record with `steerd run`")
    file = r.settings.file
    found = steering.calibrate_steering(track, steer, file.car)
    scaling = steering.servo_scaling(found, r.settings.scaling)
    print(*steering.describe_steering(found, scaling), sep="\n")
    print_warnings(found.warnings)
    return file, scaling


def mocap_arguments(parser: ArgumentParser) -> None:
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


def mocap(args: Namespace) -> int | None:
    """Check motion capture; calibrate the place of its body on the car.

    steerd mocap check --mocap natnet://HOST/car     push the car 1 m forward
    steerd mocap check DRIVE.mcap
    steerd mocap calibrate DRIVE.mcap -o car.toml    from one slow drive

    For calibration, drive figures of eight for a minute at two speeds < 1.5 m/s.
    """
    if args.kind == "check":
        return _check(args)
    from steerd.car_model.planar import DRIVES
    from steerd.daemon.setup import mount_calibration as mount
    from steerd.daemon.setup.calibration_data import load_recorded, make_drive

    check_outputs({"-o": args.output})
    r = load_recorded(args.session)
    file, gain = r.settings.file, r.settings.scaling.erpm_gain
    found = mount.calibrate_mount(make_drive(r), file.car, DRIVES.get(file.chassis.drive, 0.0))
    print(*mount.describe_mount(found, r.settings.ingest.frame, gain), sep="\n")
    print_warnings(found.warnings)
    then = "steerd run --sim --car {}\n         (on the car: --port and --mocap for --sim)"
    finish(args, file, mount.mount_values(found, gain), then)
    return None


def _check(args: Namespace) -> int:
    from steerd.daemon.setup.calibration_data import load_movement
    from steerd.daemon.setup.mocap_check import check_movement
    from steerd.daemon.setup.probe_ask import watch_movement

    if bool(args.session) == bool(args.mocap):
        hint = "steerd mocap check DRIVE.mcap, or steerd mocap check --mocap natnet://HOST/BODY"
        raise UsageError("name a session or a source", hint)
    if args.session:
        moved = load_movement(args.session)
    else:
        moved = watch_movement(args.mocap, load_settings(args.car).ingest, args.seconds)
    checks = check_movement(*moved)
    for check in checks:
        print(f"{'pass' if check.ok else 'FAIL'}  {check.name:<8} {check.figure}")
        if not check.ok:
            print(f"      try: {check.fix}")
    return ExitCode.OK if all(check.ok for check in checks) else ExitCode.STOPPED


def finish(args: Namespace, own: CarFile, values: Values, then: str) -> None:
    """Write the values into a car file, `own` where none is named; `then` is the command for it."""
    car = edit_car(load_car_file(args.car) if args.car else own, values)
    if args.output:
        write_outputs(car_outputs(args.output, car))
        print(f"{args.output}: written\n   next: {then.format(args.output)}")
    else:
        print("   next: the same with -o car.toml writes it")
