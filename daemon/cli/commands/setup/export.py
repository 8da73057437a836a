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
    option(parser, "car", "CAR.toml", "a car file", missing_car, type=Path)
    text = "FILE.yaml for f1tenth_gym, FILE.xml for MuJoCo"
    option(parser, "-o --output", "FILE", text, type=Path, required=True)


def run(args: argparse.Namespace) -> None:
    from dataclasses import replace

    from steerd.daemon.common.screen import clean, wrap
    from steerd.daemon.common.written import check_outputs, write_outputs
    from steerd.daemon.settings.config import load_settings
    from steerd.daemon.setup.car_export import make_gym_yaml, make_mjcf

    kind = args.output.suffix.lower()
    if kind not in (".yaml", ".yml", ".xml"):
        what = f"-o {args.output}: no format of that name"
        raise SteerdError(what, "name it .yaml for f1tenth_gym, .xml for MuJoCo", ExitCode.USAGE)
    check_outputs({"-o": args.output})
    settings = load_settings(args.car)
    file = replace(settings.file, name=clean(settings.file.name))
    if kind == ".xml":
        made = make_mjcf(file, settings.controller.speed)
    else:
        made = make_gym_yaml(file, settings.limits.speed_max)
    write_outputs({args.output: made.text})
    print(f"{args.output}: written. What is lost:")
    for sentence in made.lost:
        print("\n".join(wrap(sentence, "  - ", "    ")))
