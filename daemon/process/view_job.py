"""What live page and viewer show of a car before it drives: its lane, its body; and where."""

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.lab import is_private

if TYPE_CHECKING:
    from steerd.car_model.path.path import Path
    from steerd.daemon.assembly.build import RunPlan

LANE_STEP = 0.05  # distance between drawn points of a lane [m]


def draw_plan(plan: "RunPlan") -> dict[str, Any]:
    """What is drawn of a run."""
    return draw_lane(plan.path, plan.settings.thresholds.lateral, plan.settings.file.car)


def make_lane_job(spec: str | None) -> dict[str, Any]:
    """What is drawn of a lane that was named, or of none.

    Raises:
        SteerdError: it is no path.
    """
    try:
        from steerd.car_model.path.path_spec import parse_path

        return draw_lane(parse_path(spec) if spec else None, Thresholds().lateral, DEFAULT_CAR)
    except (OSError, ValueError) as error:
        raise SteerdError(f"--path {spec}: {error}", "", ExitCode.USAGE) from None


def draw_lane(path: "Path | None", half_width: float, car: Car[float]) -> dict[str, Any]:
    """A car and its lane, if that is known, as JSON values."""
    body = {"lf": car.lf, "lr": car.lr}
    if path is None:
        return {"lane": [], "closed": False, "half_width": 0.0, "body": body}
    stride = max(1, round(LANE_STEP / path.step))
    points = [*zip(path.x, path.y, path.yaw, strict=True)][::stride]
    lane = [[round(value, 6) for value in point] for point in points]
    return {"lane": lane, "closed": path.closed, "half_width": half_width, "body": body}


DEFAULT_PORT = 8765  # Foxglove's own


def parse_view(text: str, insecure_lan: bool) -> tuple[str, int]:
    """Host and port of ``[HOST:]PORT``.

    Raises:
        SteerdError: it is no address, or one for others without `--insecure-lan`.
    """
    host, _, port = text.rpartition(":")
    host = host.strip("[]") or "127.0.0.1"
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise SteerdError(f"--view {text}: [HOST:]PORT", "--view 8765", ExitCode.USAGE)
    if not is_private(host) and not insecure_lan:
        what = f"--view {text} shows the car to anybody on the network"
        raise SteerdError(what, "--insecure-lan if you mean it", ExitCode.USAGE)
    return host, int(port)


def check_view(text: str, insecure_lan: bool, *, sets: bool = False) -> None:
    """Check `--view` before anything starts.

    Raises:
        SteerdError: the address is invalid, or others could reach a viewer that `sets` parameters,
            or foxglove-sdk is not installed.
    """
    host, _ = parse_view(text, insecure_lan)
    if sets and not is_private(host):
        what = f"--view-sets: anybody who reaches {host} could change live parameters"
        raise SteerdError(what, "--view on loopback, or drop --view-sets", ExitCode.USAGE)
    if find_spec("foxglove") is None:
        hint = "pip install 'foxglove-sdk>=0.30' (or `pip install -e '.[view]'` in the checkout)"
        raise SteerdError("--view needs the package foxglove-sdk", hint, ExitCode.UNREADABLE)
