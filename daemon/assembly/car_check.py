"""Whether `steerd run` takes a car file: its settings, and the design that they ask for."""

import sys

from steerd.car_model.car_file import CarFile
from steerd.daemon.assembly.build import RunPlan, make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import print_labelled
from steerd.daemon.settings.config import Settings, make_settings
from steerd.daemon.settings.run_options import RunOptions

_PATH = "circle:radius=3"
"""A path that every car of this class can drive."""


def plan_car(car: CarFile) -> tuple[Settings, RunPlan]:
    """Settings and plan at the file's own speed; the design is part of the check.

    Raises:
        SteerdError: it holds no car that can be driven, or one without a stable controller.
    """
    settings = make_settings(car)
    options = RunOptions(str(car.path), path=_PATH, speed=settings.controller.speed)
    return settings, make_plan(options, settings)


def report_refusal(car: CarFile) -> None:
    """Print a note where `steerd run` refuses the file, so that nobody learns it at the car."""
    try:
        plan_car(car)
    except SteerdError as error:
        text = f"`steerd run` refuses this file: {error.what}\n{error.hint}".rstrip()
        print_labelled("note: ", text, sys.stderr)
