"""Pre-arm checks: what passes, what fails, and that each failure says what to do."""

from dataclasses import replace
from math import nan

import pytest

from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.loop.checks import check_lane, check_vesc, find_failures
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
    assert list(check_vesc(GOOD, BRAKES)) == []
    assert list(check_vesc(None, BRAKES)) == []


@pytest.mark.parametrize(
    ("changes", "uuid", "said"),
    [
        ({"expected": 0}, "cd" * 12, "is not the one of the car file"),
        ({"expected": 0}, "", "is not the one this run began with"),
        ({"timeout_ms": -1}, "", "did not report its timeout"),
        ({"timeout_ms": 0}, "", "never times out"),
        ({"timeout_ms": 201}, "", "timeout is 201 ms, at most 200 ms"),
        *(({"timeout_brake_current": amps}, "", "would coast on timeout") for amps in (0.0, nan)),
    ],
)
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


@pytest.mark.parametrize(
    ("e1", "e2", "said"),
    [
        (TH.lateral_warn, TH.heading_warn, None), (0.25, 0.0, "0.25 m left of the path"),
        (-0.25, 0.0, "0.25 m right of the path"), (nan, 0.0, "of the path"),
        (0.0, -1.0, "points -57° off the path"),
    ],
)  # fmt: skip
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
