"""Whether `steerd run` takes a car file: its settings, and the design that they ask for."""

from pathlib import Path

from steerd.daemon.assembly.build import RunPlan, make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.config import Settings, load_settings
from steerd.daemon.settings.run_options import RunOptions

_PATH = "circle:radius=3"
"""A path that every car of this class can drive."""


def plan_car(path: Path) -> tuple[Settings, RunPlan]:
    """Settings and plan at the file's own speed; the design is part of the check.

    Raises:
        SteerdError: the file cannot be read, holds no car, or one without a stable controller.
    """
    settings = load_settings(path)
    options = RunOptions(str(path), path=_PATH, speed=settings.controller.speed)
    return settings, make_plan(options, settings)


def find_refusal(path: Path) -> SteerdError | None:
    """Why `steerd run` would refuse a car file; None if it would not."""
    try:
        plan_car(path)
    except SteerdError as error:
        return error
    return None
