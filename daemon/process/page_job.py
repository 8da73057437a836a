"""The job of the live page's process: the car's bus, the page's port, the lane to draw."""

from typing import Any

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import Path
from steerd.car_model.path.path_spec import parse_path
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.thresholds import Thresholds

LANE_STEP = 0.05
"""Distance between drawn points of a lane [m]."""


def check_page(plan_lab: str, listen: str) -> None:
    """Refuse a page that could not reach the car.

    Raises:
        SteerdError: the car's bus asks for an operator's certificate, or there is no bus.
    """
    if plan_lab:
        what = "--page: in a lab the page runs where the operator sits"
        raise SteerdError(what, "steerd page --lab DIR, with an operator's folder", ExitCode.USAGE)
    if not listen:
        raise SteerdError("--page needs the bus", "drop --listen ''", ExitCode.USAGE)


def make_page_job(plan: RunPlan) -> dict[str, Any]:
    """The job as JSON values."""
    car = plan.settings.file.car
    return {
        "endpoint": plan.options.listen,
        "lab": "",
        "car": plan.options.car,
        "port": plan.options.page,
        **_lane(plan.path, plan.settings.thresholds.lateral),
        "body": {"lf": car.lf, "lr": car.lr},
    }


def make_lane_job(spec: str | None) -> dict[str, Any]:
    """What is drawn of a lane that was named, or of none.

    Raises:
        SteerdError: it is no path.
    """
    body = {"lf": DEFAULT_CAR.lf, "lr": DEFAULT_CAR.lr}
    if spec is None:
        return {"lane": [], "closed": False, "half_width": 0.0, "body": body}
    try:
        return {**_lane(parse_path(spec), Thresholds().lateral), "body": body}
    except (OSError, ValueError) as error:
        raise SteerdError(f"--path {spec}: {error}", "", ExitCode.USAGE) from None


def _lane(path: Path, half_width: float) -> dict[str, Any]:
    stride = max(1, round(LANE_STEP / path.step))
    points = list(zip(path.x, path.y, strict=True))[::stride]
    return {
        "lane": [[round(x, 3), round(y, 3)] for x, y in points],
        "closed": path.closed,
        "half_width": half_width,
    }
