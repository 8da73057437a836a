"""A car file for other simulators: f1tenth_gym's parameters, or a MuJoCo model.

steerd export car.toml -o f1tenth.yaml   # the params of f1tenth_gym
steerd export car.toml -o car.xml        # a MuJoCo model (MJCF)

Both hold less than the car file: what is lost is printed, and is in the file.
"""

import argparse
from pathlib import Path

from steerd.daemon.cli.arguments import missing_car, option
from steerd.daemon.common.errors import ExitCode, SteerdError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The car and the file."""
    option(parser, "car", "CAR.toml", "a car file", missing_car, type=Path)
    text = "FILE.yaml for f1tenth_gym, FILE.xml for MuJoCo"
    option(parser, "-o --output", "FILE", text, type=Path, required=True)


def run(args: argparse.Namespace) -> int:
    """Write the file and say what is not in it."""
    from steerd.daemon.common.screen import wrap
    from steerd.daemon.common.written import check_outputs, write_outputs
    from steerd.daemon.settings.car_export import make_gym_yaml, make_mjcf
    from steerd.daemon.settings.config import load_settings

    kinds = {".yaml": make_gym_yaml, ".yml": make_gym_yaml, ".xml": make_mjcf}
    make = kinds.get(args.output.suffix.lower())
    if make is None:
        what = f"-o {args.output}: no format of that name"
        raise SteerdError(what, "name it .yaml for f1tenth_gym, .xml for MuJoCo", ExitCode.USAGE)
    check_outputs({"-o": args.output})
    made = make(load_settings(args.car))
    write_outputs({args.output: made.text})
    print(f"{args.output}: written. What is lost:")
    for sentence in made.lost:
        print("\n".join(wrap(sentence, "  - ", "    ")))
    return ExitCode.OK
