"""Designed gains, remembered: python-control takes a second to import, for a few numbers.

The file's name is a digest of all that the gains depend on, the code that computes them included,
and the file is sealed under that name (`steerd.sealed_file`): gains that were changed, or made for
another car, are computed again. Every start looks at the closed loop of the gains that it will use
(`steerd.controller.build`). The folder may be deleted at any time.
"""

# Why: docs/decisions/filter-and-controller.md#d81

import contextlib
import hashlib
import json
from dataclasses import asdict
from importlib import metadata
from importlib.resources import files
from pathlib import Path

import platformdirs

from steerd.car_model.native.library import fingerprint
from steerd.car_model.params import Car
from steerd.controller.build import compute_table
from steerd.controller.config import ControllerConfig
from steerd.controller.gain_table import GainTable
from steerd.controller.loop_model import Timing
from steerd.sealed_file import make_own_folder, read_sealed, seal
from steerd.steer_bus.atomic_file import write_atomically

_CODE = ("controller/gains", "controller/loop_model", "car_model/linear", "car_model/params")
"""Modules of steerd that the gains come from."""


def designs_folder() -> Path:
    """Where remembered gains lie."""
    return platformdirs.user_cache_path("steerd") / "designs"


def recall_table(
    car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float
) -> GainTable:
    """The gains: remembered ones where there are any, else computed and remembered.

    Raises:
        DesignRefused: a speed has no design.
    """
    path = designs_folder() / f"{digest_design(car, config, timing, speed_max)}.json"
    if (known := read_sealed(path)) is not None:
        speed_min, spacing, rows = json.loads(known)
        return GainTable(speed_min, spacing, tuple(map(tuple, rows)))
    table = compute_table(car, config, timing, speed_max)
    with contextlib.suppress(OSError):  # a read-only or full disk: computed again next time
        make_own_folder(path.parent)
        write_atomically(path, seal(path.name, json.dumps(table).encode()))
    return table


def digest_design(
    car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float
) -> str:
    """All that the gains depend on, as the name of a file."""
    found = hashlib.sha256(b"sealed")
    found.update(repr((tuple(car), asdict(config), tuple(timing), speed_max)).encode())
    found.update(metadata.version("control").encode() + fingerprint().encode())
    for name in _CODE:
        found.update((files("steerd") / f"{name}.py").read_bytes())
    return found.hexdigest()[:32]
