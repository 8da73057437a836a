"""Every number of a car file at both its bounds: the car drives, or the file is refused at load.

The whole walk takes half an hour: `python -m tests.safety.test_car_file_bounds`. The tests hold
what it found.
"""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import pytest
import tomlkit

from steerd.car_model.car_file import CarFileError, default_car_path, parse_car
from steerd.car_model.effects import EFFECTS
from steerd.car_model.params import PARAMETERS
from steerd.controller.limits import CEILINGS
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.settings.thresholds import BOUNDS
from steerd.estimator.config import FilterConfig

DEFAULT = default_car_path().read_text(encoding="utf-8")
PATH, DRIVE_S = "circle:radius=3", 0.8
CONTROLLER = {
    "damping_min": (0.0, 0.99), "grid_speed_min": (1e-6, 20.0), "grid_spacing": (0.01, 100.0),
    "speed": (1e-3, 3.0), "lateral_accel_max": (1e-3, 100.0), "accel_max": (1e-3, 100.0),
    "decel_max": (1e-3, 100.0), "start_ramp": (1e-3, 100.0), "stop_ramp": (1e-3, 100.0),
}  # fmt: skip


class Case(NamedTuple):
    section: str
    key: str
    value: float


def walk() -> Iterator[Case]:
    """Both bounds of every number; the controller's have no upper bound of their own."""
    for p in PARAMETERS:
        yield from (Case("car", p.name, float(v)) for v in (p.low, p.high))
    for f in fields(FilterConfig):
        kind = type(f.default)
        yield from (Case("estimator", f.name, kind(v)) for v in f.metadata.values())
    for key, bounds in CONTROLLER.items():
        yield from (Case("controller", key, v) for v in bounds)
    for section, table in (("limits", CEILINGS), ("safety", BOUNDS)):
        for key, bound in table.items():
            if (section, key) != ("limits", "wheelbase"):  # follows from [car]
                yield from (Case(section, key, v) for v in (bound.low, bound.high))
    for name, effect in EFFECTS.items():
        for p in effect.parameters:
            yield from (Case(f"effects.{name}", p.name, float(v)) for v in (p.low, p.high))


QUICK = [
    Case("car", "steer_lag", 0.0), Case("car", "speed_lag", 0.0), Case("car", "steer_bias", 0.2),
    Case("effects.rolling_drag", "drag", -0.75), Case("effects.rolling_drag", "drag", 1.0),
    Case("effects.floor_slope", "x", 0.076), Case("effects.mocap_yaw", "offset", 0.1),
    Case("estimator", "lateral_accel_density", 0.03),
    Case("estimator", "longitudinal_accel_density", 0.1),
    Case("estimator", "pose_position_sd", 1e-4),
]  # fmt: skip
REFUSED = [
    (Case("car", "mu", 0.05), "friction 0.05 stops the car with 0.49 m/s²"),
    (Case("car", "drive_delay", 0.3), "dead time of 0.3 s is longer than"),
    (Case("effects.drive_delay", "delay", 0.3), "dead time of 0.3 s is longer than"),
    (Case("car", "lf", 1.0), "wheelbase = 1.17145 m is outside"),
    (Case("car", "speed_gain", 0.5), "drives at 0.5 times the speed of its wheels"),
    (Case("effects.speed_scale", "scale", 1.5), "a start lets 0.7 to 1.3 pass"),
    (Case("effects.rolling_drag", "drag", -1.0), "left to roll, this car speeds up by 1.00 m/s²"),
    (Case("effects.rolling_drag", "drag", 3.0), "lags 0.30 m/s behind its orders"),
    (Case("effects.floor_slope", "x", 0.1), "left to roll, this car speeds up by 0.98 m/s²"),
    (Case("effects.floor_slope", "y", -0.1), "left to roll, this car speeds up by 0.98 m/s²"),
    (Case("effects.mocap_yaw", "offset", 0.3), "mocap shows a heading +0.30 rad off the car's"),
    (Case("effects.mocap_yaw", "offset", -0.3), "mocap shows a heading -0.30 rad off the car's"),
    (Case("estimator", "lateral_accel_density", 0.0), "lateral_accel_density = 0.0 is outside"),
    (Case("estimator", "initial_poses", 100), "initial_poses = 100 is outside"),
    (Case("estimator", "pose_position_sd", 1e-6), "pose_position_sd = 1e-06 is outside"),
]


def load(case: Case):
    """The plan of a drive with this number."""
    document = tomlkit.parse(DEFAULT)
    section, _, name = case.section.partition(".")
    table = document.setdefault(section, tomlkit.table())
    if name:
        table[name] = tomlkit.table()
        table = table[name]
    table[case.key] = case.value
    speed = None if case[:2] == ("controller", "speed") else 1.0
    settings = make_settings(parse_car(tomlkit.dumps(document), Path("car.toml")), speed)
    options = RunOptions(
        car_file="", path=PATH, speed=settings.controller.speed, duration_s=DRIVE_S, simulated=True,
        auto_arm=True,
    )  # fmt: skip
    return make_plan(options, settings)


def go(case: Case) -> str:
    """How the drive ended: nothing, the reason of a stop, or what it waited for."""
    run = make_virtual_run(load(case))
    drive(run)
    assert run.core.error is None, run.core.error
    loop = run.core.loop
    if loop.faulted:
        return loop.supervisor.reason
    return "" if loop.ran else f"waits for {run.core.last.waiting}"


@pytest.mark.slow
@pytest.mark.parametrize("case", QUICK, ids=str)
def test_a_car_at_a_bound_drives(case):
    assert go(case) == ""


@pytest.mark.parametrize(("case", "said"), REFUSED, ids=str)
def test_what_cannot_drive_is_refused_at_load(case, said):
    with pytest.raises(SteerdError) as caught:
        load(case)
    assert said in caught.value.what
    assert len(caught.value.what.splitlines()) == 1


def test_the_walk_covers_every_section():
    cases = list(walk())
    assert {case.section.partition(".")[0] for case in cases} == {
        "car", "estimator", "controller", "limits", "safety", "effects"
    }  # fmt: skip
    assert len(cases) > 300


def report(sections: tuple[str, ...]) -> Iterator[str]:
    """One line for every number at a bound; `python -m tests.safety.test_car_file_bounds car`."""
    for case in walk():
        if sections and not case.section.startswith(sections):
            continue
        try:
            ended = go(case) or "drove"
        except (SteerdError, CarFileError) as error:
            ended = f"refused: {error}"
        yield f"{case.section}.{case.key} = {case.value:g}: {ended}"


if __name__ == "__main__":
    import sys

    for line in report(tuple(sys.argv[1:])):
        print(line, flush=True)
