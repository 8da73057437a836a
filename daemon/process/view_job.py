"""The job of the viewer's process: address, lane, car, values of the car file."""

import ipaddress
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.toml_text import parse_toml

if TYPE_CHECKING:
    from steerd.daemon.assembly.build import RunPlan

DEFAULT_PORT = 8765
"""Foxglove's own."""
_WIDTH = 0.27
"""Width of an F1TENTH car [m]; only drawn."""


def parse_view(text: str, insecure_lan: bool) -> tuple[str, int]:
    """Host and port of ``[HOST:]PORT``.

    Raises:
        SteerdError: it is no address, or one for others without `--insecure-lan`.
    """
    host, _, port = text.rpartition(":")
    host = host.strip("[]") or "127.0.0.1"
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise SteerdError(f"--view {text}: [HOST:]PORT", "--view 8765", ExitCode.USAGE)
    if not _is_private(host) and not insecure_lan:
        what = f"--view {text} shows the car to anybody on the network"
        raise SteerdError(what, "--insecure-lan if you mean it", ExitCode.USAGE)
    return host, int(port)


def _is_private(host: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_view(text: str, insecure_lan: bool, *, sets: bool = False) -> None:
    """Check `--view` before anything starts.

    Raises:
        SteerdError: the address is invalid, or others could reach a viewer that `sets` parameters,
            or foxglove-sdk is not installed.
    """
    host, _ = parse_view(text, insecure_lan)
    if sets and not _is_private(host):
        what = f"--view-sets: anybody who reaches {host} could change live parameters"
        raise SteerdError(what, "--view on loopback, or drop --view-sets", ExitCode.USAGE)
    if find_spec("foxglove") is None:
        hint = "pip install 'foxglove-sdk>=0.30' (or `pip install -e '.[view]'` in the checkout)"
        raise SteerdError("--view needs the package foxglove-sdk", hint, ExitCode.UNREADABLE)


def make_view_job(plan: "RunPlan") -> dict[str, Any]:
    """The viewer's job as JSON values.

    Raises:
        SteerdError: the address is invalid.
    """
    from steerd.daemon.process.page_job import LANE_STEP

    host, port = parse_view(plan.options.view, plan.options.insecure_lan)
    path, settings = plan.path, plan.settings
    stride = max(1, round(LANE_STEP / path.step))
    lane = list(zip(path.x, path.y, path.yaw, strict=True))[::stride]
    run = {"path": plan.options.path, "speed": plan.options.speed, "rate_hz": plan.options.rate_hz}
    return {
        "host": host,
        "port": port,
        "car": plan.options.car,
        "lane": lane,
        "closed": path.closed,
        "half_width": settings.thresholds.lateral,
        "body": {"lf": settings.file.car.lf, "lr": settings.file.car.lr, "width": _WIDTH},
        "parameters": {
            "run": run,
            "car": settings.file.car._asdict(),
            "file": parse_toml(settings.file.text),
        },
    }
