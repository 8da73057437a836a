"""Excitation plans: what they ask for, and that they fit their box and their limits."""

import shlex
from math import tan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.params import DEFAULT_CAR, wheelbase
from steerd.car_model.state import Command
from steerd.controller.limits import Limits
from steerd.daemon.assembly import plans
from steerd.daemon.cli.commands.completion import make_full_parser
from steerd.sim_gap.verdict.next_manoeuvre import MENU

pytestmark = pytest.mark.slow

LIMITS = Limits(0.33, 0.31, 0.26)


def test_circles_are_the_papers_sixteen():
    drill = plans.parse_drill("circles;speed=2.5", DEFAULT_CAR, LIMITS)
    driven = [s for s in drill.segments if s.speed > 0.0]
    assert [s.seconds for s in driven] == [8.0] * 16
    assert {s.speed for s in driven} == {1.0}
    assert [s.steer for s in driven] == [0.31] * 8 + [-0.26] * 8


@pytest.mark.parametrize("name", ["ramp", "speeds"])
def test_what_changes_speed_alone_corners_as_hard_as_the_limits_allow(name):
    drill = plans.parse_drill(f"{name};speed=2.5", DEFAULT_CAR, LIMITS)
    driven = [s for s in drill.segments if s.speed > 0.0]
    assert {s.swing for s in driven} == {0.0}
    assert {s.steer > 0.0 for s in driven} == {True, False}, "to both sides"
    fastest = max(driven, key=lambda s: s.speed)
    sideways = fastest.speed**2 * tan(abs(fastest.steer)) / wheelbase(DEFAULT_CAR)
    assert 0.85 * LIMITS.lateral_accel_max < sideways <= LIMITS.lateral_accel_max
    if name == "ramp":
        speeds = [s.speed for s in driven]
        half = len(speeds) // 2
        assert speeds[:half] == sorted(speeds[:half])


@pytest.mark.parametrize("drive", MENU.values(), ids=lambda drive: drive.command)
def test_what_a_diagnosis_asks_for_is_what_its_command_drives(drive):
    words = shlex.split(drive.command)
    args = make_full_parser().parse_args(words[1:])
    steer, speed = drive.drive(np.arange(0.0, 8.0, 0.01))
    assert np.max(speed) == pytest.approx(args.speed, rel=0.01)
    if words[1] == "collect":
        drill = plans.parse_drill(f"{args.plan};speed={args.speed}", DEFAULT_CAR, LIMITS)
        left = [s for s in drill.segments if s.steer > 0.0]
        assert max(s.speed for s in left) == pytest.approx(args.speed, rel=0.05)
        assert max(s.steer + s.swing for s in left) == pytest.approx(np.max(steer), rel=0.1)
        assert min(s.steer - s.swing for s in left) == pytest.approx(np.min(steer), rel=0.25)


@settings(derandomize=True, deadline=None, max_examples=8)
@given(name=st.sampled_from(plans.NAMES), side=st.floats(4.0, 30.0), speed=st.floats(0.5, 3.0))
def test_a_plan_fits_its_box_and_its_limits_and_stands_after_it_or_is_refused(name, side, speed):
    box = plans.parse_box(f"{side}")
    try:
        drill = plans.make_open_drill(name, DEFAULT_CAR, LIMITS, box, speed)
    except ValueError:
        return
    assert max(plans.forecast_reach(DEFAULT_CAR, drill.segments)) <= 0.5 * side
    for k in range(int(drill.seconds / 0.1)):
        wish = drill.command_at(0.1 * k)
        assert -LIMITS.steer_right_max - 1e-9 <= wish.steer <= LIMITS.steer_left_max + 1e-9
        assert 0.0 <= wish.speed <= max(speed, plans.PAPER_SPEED) + 1e-9
    assert drill.command_at(drill.seconds + 1.0) == Command(0.0, 0.0)


def test_a_probe_rides_on_the_lane_keeper():
    drill = plans.parse_drill("mixed;closed", DEFAULT_CAR, LIMITS)
    lane = Command(0.1, 2.0)
    commands = [drill.wish(0.05 * k, lane) for k in range(int(drill.seconds / 0.05))]
    assert max(w.steer for w in commands) == pytest.approx(0.1 + plans.PROBE)
    assert {round(w.speed, 3) for w in commands} >= {1.0, 1.5, 2.0}


@pytest.mark.parametrize(("spec", "said"), [
    ("loops", "one of circles, slalom"), ("circles;closed", "driven open loop"),
    ("mixed;box=1", "needs a box"), ("mixed;box=a", "give its side"),
    ("steps;box=1,1,0,0", "give its side"),
])  # fmt: skip
def test_plans_that_make_no_sense_are_refused(spec, said):
    with pytest.raises(ValueError, match=said):
        plans.parse_drill(spec, DEFAULT_CAR, LIMITS)


def test_a_box_has_corners_and_the_path_under_a_probe_fits_or_is_refused():
    assert plans.parse_box("-1,-2,3,4").fence == ((-1, -2), (3, -2), (3, 4), (-1, 4))
    for side, path in (("20", "figure8"), ("8", "circle")):
        assert plans.make_closed_path(plans.parse_box(side)).startswith(path)
    with pytest.raises(ValueError, match="needs a box"):
        plans.make_closed_path(plans.parse_box("4"))
