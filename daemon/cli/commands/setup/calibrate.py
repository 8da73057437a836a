"""Calibrate the steering's centre, gain and limits, from a session or by keys.

steerd calibrate servo DRIVE.mcap -o car.toml
steerd calibrate servo --port /dev/ttyACM0 --car car.toml -o car.toml

With --port only the servo moves, never the motor; lift the front wheels. Arrow
keys steer; set the centre, the left and the right stop where the servo is.
"""

import argparse
import sys
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import missing_car, missing_session, option
from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.car_model.car_file import CarFile
    from steerd.daemon.settings.car_edit import Values
    from steerd.daemon.setup.steering_calibration import SteeringCalibration
    from steerd.vesc_link.scaling import Scaling


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="servo")
    servo = kinds.add_parser("servo", help="centre, gain and limits of the steering")
    option(servo, "session", "SESSION", "", missing_session, nargs="?", type=Path)
    option(servo, "--port", "DEV", "move the servo of this VESC by the keys")
    option(servo, "--car", "FILE.toml", "car file to start from", missing_car, type=Path)
    option(servo, "-o --output", "CAR.toml", "car file to make", type=Path)


def run(args: argparse.Namespace) -> int:
    from steerd.daemon.common.written import check_outputs

    if bool(args.session) == bool(args.port):
        hint = "steerd calibrate servo DRIVE.mcap, or steerd calibrate servo --port DEV"
        raise SteerdError("name a session or a port", hint, ExitCode.USAGE)
    check_outputs({"-o": args.output})
    return _from_keys(args) if args.port else _from_session(args)


def _from_session(args: argparse.Namespace) -> int:
    from steerd.daemon.setup.calibration_data import load_recorded
    from steerd.daemon.setup.steering_calibration import calibrate_steering
    from steerd.steer_bus import topics

    r = load_recorded(args.session)
    track, steer = r.read.track, r.read.signal(topics.ACTUATION, "steer")
    if track is None or steer is None:
        missing = "steering commands" if track else "motion"
        raise SteerdError(f"the session holds no {missing}", "record with `steerd run`")
    file = r.settings.file
    found = calibrate_steering(track.t, track.speed, track.yaw_rate, steer.t, steer.value, file.car)
    scaling = servo_scaling(found, r.settings.scaling)
    print_found(_describe(found, scaling), found.warnings)
    return finish(args, file, servo_values(scaling), "steerd config --check {}")


def servo_scaling(found: "SteeringCalibration", old: "Scaling") -> "Scaling":
    """Servo gain, centre and limits with which a commanded angle is the wheels' angle.

    A limit moves inwards only, to where the wheels stopped following.
    """
    from dataclasses import replace

    gain = old.servo_gain / found.gain
    offset = old.servo_offset - gain * found.bias
    low, high = old.servo_min, old.servo_max
    for angle, clipped in ((found.left, found.clipped_left), (found.right, found.clipped_right)):
        position = gain * angle + offset
        if clipped and position < offset:
            low = max(low, position)
        elif clipped:
            high = min(high, position)
    return replace(old, servo_gain=gain, servo_offset=offset, servo_min=low, servo_max=high)


def servo_values(scaling: "Scaling") -> dict[tuple[str, str], float]:
    """The servo's part of a car file; the model's own gain and bias become 1 and 0."""
    names = ("servo_gain", "servo_offset", "servo_min", "servo_max")
    values = {("vesc", name): round(float(getattr(scaling, name)), 4) for name in names}
    return {**values, ("car", "steer_gain"): 1.0, ("car", "steer_bias"): 0.0}


def _describe(found: "SteeringCalibration", scaling: "Scaling") -> list[str]:
    stops = {True: "a stop", False: "no stop reached"}
    return [
        f"wheel angle = {found.gain:.3f} ± {found.sd_gain:.3f} × command "
        f"{degrees(found.bias):+z.2f}° ± {degrees(found.sd_bias):.2f}°",
        f"delay {1e3 * found.delay:.0f} ms, lag included",
        f"reached {degrees(found.left):.1f}° left ({stops[found.clipped_left]}), "
        f"{degrees(-found.right):.1f}° right ({stops[found.clipped_right]})",
        f"servo: gain {scaling.servo_gain:.4f} per rad, centre {scaling.servo_offset:.4f}, "
        f"from {scaling.servo_min:.3f} to {scaling.servo_max:.3f}",
    ]


def print_found(lines: Sequence[str], warnings: Sequence[str]) -> None:
    """Show what a calibration found."""
    from steerd.daemon.sessions.text import print_warnings

    print("\n".join(lines))
    print_warnings(warnings)


def finish(args: argparse.Namespace, own: "CarFile", values: "Values", then: str) -> int:
    """Write what a calibration found into a car file, and say what is next.

    Args:
        args: `car` names the file to start from, `output` the one to make.
        own: the car file to start from where none is named.
        values: of the calibration.
        then: the command for the file that was made.
    """
    from steerd.daemon.common.translate import load_car_file
    from steerd.daemon.settings.car_edit import write_edited

    if write_edited(args.output, load_car_file(args.car) if args.car else own, values):
        print(f"{args.output}: written\n   next: {then.format(args.output)}")
    else:
        print("   next: the same with -o car.toml writes it")
    return ExitCode.OK


def _from_keys(args: argparse.Namespace) -> int:
    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.settings.config import load_settings
    from steerd.daemon.terminal.servo_keys import steer_by_keys
    from steerd.steer_bus.clock import MonotonicClock

    path = args.car or default_car_path()
    settings = load_settings(path)
    print("only the servo moves; lift the front wheels", file=sys.stderr)
    scaling = steer_by_keys(args.port, settings.scaling, MonotonicClock())
    if scaling is None:
        print("nothing was changed")
        return ExitCode.INTERRUPTED
    return finish(args, settings.file, servo_values(scaling), "steerd config --check {}")
