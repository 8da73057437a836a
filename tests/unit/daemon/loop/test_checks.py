"""Pre-arm checks, whose failures say what to do; and the launch window: each rule at its edge."""

from dataclasses import replace
from math import atan, cos, nan, pi, sin, tan

import pytest

from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.loop import checks
from steerd.daemon.loop.checks import LaunchInput, check_lane, check_vesc, find_failures
from steerd.daemon.loop.findings import Flag, Severity, make_finding
from steerd.daemon.loop.lease import Lease, Remote
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.settings.run_options import ControllerKind, RunOptions
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.messages import BODY, DriveCommand, VescIdentity, make_header
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.watching import CALM

BRAKES = BrakeSettings()
GOOD = VescIdentity(make_header(0, BODY), 0, 150, 1, 6, 2, 5.0, "ab" * 12)
TH, BOOT = Thresholds(), 7


def test_a_good_vesc_passes_and_an_unknown_one_is_not_checked():
    assert list(check_vesc(GOOD, BRAKES)) == list(check_vesc(None, BRAKES)) == []


@pytest.mark.parametrize(("changes", "uuid", "said"), [
    ({"expected": 0}, "cd" * 12, "is not the one of the car file"),
    ({"expected": 0}, "", "is not the one this run began with"),
    ({"timeout_ms": -1}, "", "did not report its timeout"),
    ({"timeout_ms": 0}, "", "never times out"),
    ({"timeout_ms": 201}, "", "timeout is 201 ms, at most 200 ms"),
    *(({"timeout_brake_current": amps}, "", "would coast on timeout") for amps in (0.0, nan)),
])  # fmt: skip
def test_a_vesc_that_must_not_be_armed(changes, uuid, said):
    (text,) = check_vesc(changed(GOOD, **changes), BrakeSettings(uuid=uuid))
    assert said in text


@pytest.fixture(scope="module")
def plan():
    real = RunId(BOOT, 0, leased=True)
    return make_plan(RunOptions(car_file="", path="line"), real=real)


def fails(plan, findings=(), flags=Flag.LINKED, last=None, **now):
    """Failures of a car that stands ready, but for what is given."""
    now = changed(CALM, state=SupervisorState.DISARMED, **{"speed": 0.0, **now})
    remote = Remote(Lease(BOOT, 5, 0, CALM.t_ns), last)
    return list(find_failures(plan, GOOD, remote, now, findings, flags, estimated=True))


@pytest.mark.parametrize(("e1", "e2", "said"), [
    (TH.lateral_warn, TH.heading_warn, None), (0.25, 0.0, "0.25 m left of the path"),
    (-0.25, 0.0, "0.25 m right of the path"), (nan, 0.0, "of the path"),
    (0.0, -1.0, "points -57° off the path"),
])  # fmt: skip
def test_the_car_must_stand_in_its_lane(e1, e2, said):
    found = list(check_lane(e1, e2, TH))
    assert len(found) == (said is not None)
    assert all(said in text for text in found)


def test_with_an_external_controller_only_its_commands_count(plan):
    remote = replace(plan, options=replace(plan.options, controller=ControllerKind.ZENOH))
    command = DriveCommand(make_header(0, BODY), BOOT, 5, 0, 0, 100, 0.0, 0.0)
    assert fails(remote, last=command, lateral_error=1.0) == []
    (text,) = fails(remote, lateral_error=1.0)
    assert "steerd control" in text


def test_a_trip_and_a_vesc_without_the_session_limits_fail_and_a_warning_does_not(plan):
    trip, warning = make_finding("W13", "3.2 V"), make_finding("W7", "60 ms", Severity.WARN)
    assert fails(plan, (warning, trip)) == [trip.text]
    (text,) = fails(plan, flags=Flag.LINKED | Flag.UNBOUNDED)
    assert "power it off and on" in text


@pytest.mark.parametrize(("speed", "count"), [(0.049, 0), (-0.049, 0), (0.05, 1), (nan, 1)])
def test_a_car_that_moves_or_may_move_fails(plan, speed, count):
    assert len(fails(plan, speed=speed)) == count


# The launch window.
WHEELBASE = 0.33


def launch(steer=0.0, scale=1.0, flip=0.0, turn=1.0, erpm=1.0, speed=0.5, yaw0=0.3, noise=0.0):
    """Drive a kinematic car; return (what was wrong, distance by the wheels, done)."""
    x = y = travelled = 0.0
    yaw, dt = yaw0, 0.01
    start = LaunchInput(0, x * scale, y * scale, yaw + flip, 0.0, steer)
    state, wrong = checks.LaunchState(start, start.x, start.y), ""
    for k in range(1, 400):
        x, y = x + speed * dt * cos(yaw), y + speed * dt * sin(yaw)
        yaw += turn * speed * dt * tan(steer) / WHEELBASE
        wobble = noise if k % 2 else -noise
        i = LaunchInput(k * 10**7, x * scale + wobble, y * scale, yaw + flip, speed * erpm, steer)
        state, wrong = checks.step_launch(state, i, WHEELBASE)
        travelled += abs(speed) * erpm * dt
        if wrong or state.done:
            break
    return wrong, travelled, state.done


@pytest.mark.parametrize("steer", [0.0, 0.34, -0.34, 0.05])
@pytest.mark.parametrize("yaw0", [0.0, 3.0, -3.1])
def test_a_good_launch_ends_after_half_a_metre(steer, yaw0):
    wrong, travelled, done = launch(steer=steer, yaw0=yaw0, noise=0.002)
    assert (wrong, done) == ("", True)
    assert travelled == pytest.approx(0.5, abs=0.006)


@pytest.mark.parametrize(("given", "said"), [
    *(({"scale": scale}, "units") for scale in (0.001, 1000.0, 0.0, 0.69, 1.42)),
    ({"erpm": 0.0}, "units"),  # wheels that do not count
    *(({"flip": flip}, "body forward axis") for flip in (pi, pi / 2, -0.55, 0.55)),
    ({"flip": 0.5}, ""), ({"flip": -0.5}, ""),
    *(({"steer": steer, "turn": -1.0}, "against its steering") for steer in (0.2, -0.2)),
    # A reversing car is judged in its own direction.
    ({"speed": -0.5}, ""), ({"speed": -0.5, "flip": pi}, "body forward axis"),
])  # fmt: skip
def test_a_launch_finds_what_is_wrong_and_is_done_otherwise(given, said):
    wrong, travelled, done = launch(**given)
    assert said in wrong
    assert (wrong == "") is (said == "") is done
    assert travelled <= 0.26 or said != "units"


def shown(mocap, wheels, turned=0.0, expected=0.0):
    """What one more, motionless tick says to a launch that has shown this, far from the origin."""
    here = LaunchInput(0, 5.0 + mocap, -3.0, 0.0, 0.0, 0.0)
    state = checks.LaunchState(here, here.x, here.y)._replace(
        x0=5.0, travelled=wheels, turned=turned, expected_turn=expected, forward=mocap
    )
    return checks.step_launch(state, here, WHEELBASE)


def test_every_bound_of_the_launch_exactly():
    assert shown(0.0, 0.2499)[1] == shown(0.2499, 0.0)[1] == ""
    for distances in ((0.0, 0.25), (0.25, 0.0)):
        assert "units" in shown(*distances)[1]
    assert shown(0.5, 0.5) == (shown(0.5, 0.5)[0]._replace(done=True), "")
    assert not shown(0.5, 0.4999)[0].done
    assert "against" in shown(0.5, 0.5, turned=-0.03, expected=0.10)[1]
    for turned, expected in ((-0.0299, 0.10), (-0.03, 0.0999), (0.03, 0.10)):
        assert shown(0.5, 0.5, turned, expected)[1] == ""


def end_of(x=0.25, y=0.0, wheels=0.25, yaw=0.0, steer=0.0, t_s=1):
    """One long step from the origin, heading along x: the state after it, and what was wrong."""
    begun = checks.LaunchState(LaunchInput(0, *(0.0,) * 5), 0.0, 0.0)
    return checks.step_launch(begun, LaunchInput(t_s * 10**9, x, y, yaw, wheels, steer), 1.0)


def test_the_ratio_of_distances_to_its_last_digit_and_no_time_backwards():
    wrong = ["units" in end_of(x=x, wheels=1.0)[1] for x in (0.6999, 0.7, 1.4, 1.4001)]
    assert wrong == [True, False, False, True]
    back, wrong = end_of(x=0.0, wheels=0.5, t_s=-1)
    assert (back.travelled, wrong) == (0.0, "")


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_thirty_degrees_off_the_heading(side):
    inside, beyond = (
        end_of(x=0.5 * cos(angle), y=side * 0.5 * sin(angle), wheels=0.5)[1]
        for angle in (pi / 6 - 1e-9, pi / 6 + 1e-9)
    )
    assert "body forward axis" not in inside
    assert f"travels {side * 30:.0f}° off its mocap heading: body forward axis" in beyond


def test_a_launch_that_went_wrong_is_not_done_and_a_done_one_is_left_alone():
    state, wrong = end_of(x=2.0, wheels=1.0)
    assert wrong
    assert not state.done
    done = end_of(x=0.5, wheels=0.5)[0]
    after = LaunchInput(2_000_000_000, 99.0, 0.0, 3.0, 0.0, 0.0)
    assert checks.step_launch(done, after, 1.0) == (done, "")


def test_what_is_said_is_said_to_the_letter():
    units = end_of(x=2.0, wheels=1.0)[1]
    assert units == "mocap moved 2.00 m, wheels 1.00 m: units, body or gear ratio"
    turned = end_of(y=0.5, x=0.0, wheels=0.5)[1]
    assert turned == "the car travels 90° off its mocap heading: body forward axis"
    against = end_of(x=0.5, wheels=0.5, yaw=-0.1, steer=atan(0.5))[1]
    assert against == "the car turns against its steering: servo direction, or mocap handedness"
