"""The car file: print a default, check one, convert gains of F1TENTH's vesc.yaml.

steerd config > car.toml
steerd config --check car.toml
steerd config --from-vesc-yaml vesc.yaml > car.toml
steerd config --check car.toml --to-vesc-yaml vesc.yaml
"""

import argparse
import re
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.cli.arguments import missing_car, missing_file, option
from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.daemon.settings.config import Settings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    option(parser, "--check", "FILE.toml", "check this car file", missing_car, type=Path)
    text = "print a car file with its gains"
    option(parser, "--from-vesc-yaml", "FILE", text, missing_file, type=Path)
    option(parser, "--to-vesc-yaml", "FILE", "write the gains there, or make the file", type=Path)


def run(args: argparse.Namespace) -> None:
    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.settings.car_edit import edit_car
    from steerd.daemon.settings.config import load_settings

    path = args.check or default_car_path()
    if args.from_vesc_yaml:
        from steerd.daemon.settings.vesc_yaml import make_car_values, read_vesc_yaml

        base = load_settings(path)
        scaling = read_vesc_yaml(_read(args.from_vesc_yaml), base.scaling)
        print(edit_car(base.file, make_car_values(scaling)).text, end="")
    elif args.to_vesc_yaml:
        from steerd.daemon.common.written import write_outputs
        from steerd.daemon.settings.vesc_yaml import make_vesc_yaml

        settings, out = load_settings(path), args.to_vesc_yaml
        text = make_vesc_yaml(settings.scaling, _read(out) if out.exists() else "")
        write_outputs({out: text})
        print(f"{out}: gains of {settings.file.name}")
    elif args.check:
        _check(args.check)
    else:
        print(load_settings(path).file.text, end="")


def _check(path: Path) -> None:
    from steerd.daemon.assembly.build import plan_car
    from steerd.daemon.common.screen import NBSP, wrap
    from steerd.daemon.common.translate import load_car_file

    settings, plan = plan_car(load_car_file(path))
    print("\n".join(describe(settings)))
    label = "  controller  "
    about = re.sub(r"(?<=\d) (?=[mH])", NBSP, plan.controller.report.describe())  # with its unit
    print("\n".join(wrap(about, label, " " * len(label))))


def describe(settings: "Settings") -> list[str]:
    """Summary of a car file, to compare with the car."""
    from steerd.vesc_link.scaling import steer_limits

    car, scaling, limits = settings.file.car, settings.scaling, settings.limits
    right, left = steer_limits(scaling)
    effects = ", ".join(effect.name for effect in settings.file.effects) or "none"
    return [
        f"{settings.file.path}: {settings.file.name}",
        f"  car         wheelbase {car.lf + car.lr:.4f} m, mass {car.mass:g} kg, grip {car.mu:g}",
        f"  steering    {degrees(limits.steer_left_max):.1f}° left, "
        f"{degrees(limits.steer_right_max):.1f}° right"
        f" (the servo reaches {degrees(left):.1f}° and {degrees(-right):.1f}°)",
        f"  speed       {settings.controller.speed:g} m/s, at most {limits.speed_max:g} m/s; "
        f"{scaling.erpm_gain:g} ERPM per m/s",
        f"  stop        {settings.brakes.brake_current_a:g} A brake current",
        f"  effects     {effects}",
    ]


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not a text file"
        hint = "name F1TENTH's vesc.yaml"
        raise SteerdError(f"{path}: {why}", hint, ExitCode.UNREADABLE) from None
