"""Plans: what is refused before anything starts, and what the design may count on."""

from dataclasses import replace

import pytest

from steerd.daemon.assembly.build import make_design_car, make_plan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.run_options import RunOptions

OPTIONS = RunOptions(car_file="", path="line", speed=1.0)


@pytest.mark.parametrize(
    ("changes", "said", "code"),
    [
        ({"port": "/dev/ttyACM0", "rate_hz": 49.0}, "50 to 1000 Hz", ExitCode.USAGE),
        ({"port": "/dev/x", "simulated": True, "rate_hz": 19.0}, "20 to 1000 Hz", ExitCode.USAGE),
        ({"rate_hz": 1001.0}, "20 to 1000 Hz", ExitCode.USAGE),
        ({"car": "a/b"}, "--name", ExitCode.USAGE),
        ({"path": "spiral"}, "--path spiral", ExitCode.USAGE),
        ({"path": "csv:/nowhere.csv"}, "--path csv:/nowhere.csv", ExitCode.USAGE),
        ({"drill": "mixed;open;box=0.5"}, "needs a box of", ExitCode.USAGE),
    ],
)
def test_options_that_cannot_be_driven_are_refused(changes, said, code):
    with pytest.raises(SteerdError) as error:
        make_plan(replace(OPTIONS, **changes), design=False)
    assert said in error.value.what
    assert error.value.code == code


def test_a_drills_box_becomes_the_fence():
    plan = make_plan(replace(OPTIONS, drill="mixed;open;speed=1;box=9"), design=False)
    assert plan.settings.thresholds.fence == plan.drill.box.fence
    assert len(plan.settings.thresholds.fence) == 4


def test_the_design_counts_on_the_limited_steering_only():
    settings = make_plan(OPTIONS, design=False).settings
    tight = replace(settings, limits=replace(settings.limits, steer_left_max=0.1))
    car = make_design_car(tight)
    assert car.steer_max == 0.1
    assert car.steer_min == make_design_car(settings).steer_min
