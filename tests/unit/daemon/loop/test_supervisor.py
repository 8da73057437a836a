"""Stories through the state machine, tick by tick, with each duration met exactly."""

from dataclasses import fields
from math import inf

import pytest

from steerd.daemon.loop.supervisor import (
    NEVER,
    OPEN_FRAMES,
    WAITING,
    SupervisorMemory,
    make_supervisor_memory,
)
from steerd.daemon.loop.transitions import (
    ARMED,
    DISARMED,
    INIT,
    READY,
    RUNNING,
    SELF_TEST,
    Fact,
    MotorOutput,
    Request,
    SteeringOutput,
)
from tests.unit.daemon.loop.supervisor_rig import GOOD, MS, Car


def test_it_begins_with_nothing_shown_nothing_held_and_no_speed():
    begun = make_supervisor_memory(5)
    expected = SupervisorMemory(
        INIT, 5, 5, "started", NEVER, NEVER, NEVER, 0.0, False, False, OPEN_FRAMES
    )
    assert begun == expected
    for field in fields(SupervisorMemory):
        assert type(getattr(begun, field.name)) is type(getattr(expected, field.name)), field.name
    assert (NEVER, OPEN_FRAMES) == (-1, 3)


def test_opening_the_port_brakes_three_times_then_is_silent():
    car = Car()
    car.facts = 0
    assert [car.tick() for _ in range(3)] == [INIT] * 3
    assert car.action.motor == MotorOutput.SILENT
    car.facts = Fact.LINKED
    motors = []
    for _ in range(5):
        car.tick()
        motors.append(car.action.motor)
    assert motors == [MotorOutput.SOFT_BRAKE] * 3 + [MotorOutput.SILENT] * 2
    car.facts = 0
    car.tick()
    car.facts = GOOD
    motors = []
    while car.tick() == INIT:
        motors.append(car.action.motor)
    assert motors == [MotorOutput.SOFT_BRAKE] * 3
    assert car.memory.state == DISARMED


def test_disarmed_centres_for_half_a_second_and_needs_passing_checks_for_one():
    car = Car()
    car.until(DISARMED)
    assert car.outputs() == (MotorOutput.SILENT, SteeringOutput.CENTRE)
    car.ticks(49)
    assert car.action.steering == SteeringOutput.CENTRE
    car.tick()
    assert car.action.steering == SteeringOutput.NONE
    assert car.ticks(50) == DISARMED
    assert car.tick() == READY  # 1.00 s after the first tick in DISARMED
    assert WAITING[car.memory.state] == "arm"


def fail_a_check(car):
    car.facts &= ~Fact.CHECKS_PASS
    car.tick()
    car.facts |= Fact.CHECKS_PASS


@pytest.mark.parametrize(
    ("interrupt", "again"),
    [
        (fail_a_check, True), (lambda car: car.tick(dt=101 * MS), True),
        (lambda car: car.tick(dt=-5000 * MS), True), (lambda car: car.tick(dt=0), False),
    ],
    ids=["a failed check", "a gap between ticks", "a clock that runs backwards", "no time"],
)  # fmt: skip
def test_what_starts_the_second_of_passing_checks_again(interrupt, again):
    car = Car()
    car.until(DISARMED)
    car.ticks(50)
    interrupt(car)
    assert car.memory.state == DISARMED
    assert car.ticks(100 if again else 50) == DISARMED
    assert car.tick() == READY


def test_a_tenth_of_a_second_between_ticks_still_counts():
    car = Car()
    car.until(DISARMED)
    assert car.ticks(10, dt=100 * MS) == DISARMED
    assert car.tick(dt=100 * MS) == READY


@pytest.mark.parametrize("missing", [Fact.LINKED, Fact.IDENTIFIED])
def test_quiet_states_fall_back_to_init_without_the_vesc(missing):
    for prepare in (lambda c: c.until(DISARMED), Car.ready):
        car = Car()
        prepare(car)
        car.facts &= ~missing
        assert car.tick() == INIT
        car.facts |= missing
        car.until(DISARMED)


def test_arming_is_silent_until_the_timeout_has_shown_for_210_ms():
    car = Car().ready()
    assert car.tick(Request.ARM) == SELF_TEST
    for _ in range(21):
        assert car.tick() == SELF_TEST
        assert car.outputs() == (MotorOutput.SILENT, SteeringOutput.NONE)
    assert car.tick() == ARMED
    assert car.outputs() == (MotorOutput.HOLD_BRAKE, SteeringOutput.CENTRE)
    assert car.memory.reason == "VESC's timeout proven"


def test_timeout_bit_that_never_rises_refuses_to_arm_and_says_why():
    car = Car().ready()
    car.facts &= ~Fact.FW_TIMEOUT
    car.tick(Request.ARM)
    assert car.ticks(19) == SELF_TEST
    assert car.tick() == DISARMED  # timeout 150 ms + 50 ms
    assert "Close VESC Tool" in car.memory.reason


def test_timeout_bit_may_rise_as_late_as_its_timeout_plus_50_ms():
    car = Car().ready()
    car.facts &= ~Fact.FW_TIMEOUT
    car.tick(Request.ARM)
    car.ticks(19)
    car.facts |= Fact.FW_TIMEOUT
    assert car.ticks(21) == SELF_TEST
    assert car.tick() == ARMED


def test_another_programs_alive_every_200_ms_is_found():
    car = Car().ready()
    car.tick(Request.ARM)
    seen = set()
    for k in range(60):  # 150 ms fed, 50 ms timed out, and so on
        car.facts = (
            (car.facts | Fact.FW_TIMEOUT) if k % 20 >= 15 else (car.facts & ~Fact.FW_TIMEOUT)
        )
        seen.add(car.tick())
    assert ARMED not in seen
    assert car.memory.state == DISARMED


def test_arm_needs_a_lease_and_no_stop_request():
    for asked in (Request.STOP, Request.DISARM, Request.ABORT, Request.UNKNOWN, 1 << 12):
        assert Car().ready().tick(int(Request.ARM) | int(asked)) == READY
    car = Car().ready()
    car.facts &= ~Fact.LEASED
    assert car.tick(Request.ARM) == READY


@pytest.mark.parametrize("asked", [Request.STOP, Request.DISARM, Request.ABORT, Request.UNKNOWN])
def test_self_test_can_be_called_off(asked):
    car = Car().ready()
    car.tick(Request.ARM)
    assert car.tick(asked) == DISARMED
    assert car.memory.reason == "arming called off"


@pytest.mark.parametrize(
    ("gone", "reason"),
    [(Fact.LEASED, "lease or deadman lost"), (Fact.CHECKS_PASS, "a pre-arm check failed")],
)
def test_self_test_ends_with_its_conditions(gone, reason):
    car = Car().ready()
    car.tick(Request.ARM)
    car.facts &= ~gone
    assert car.tick() == DISARMED
    assert car.memory.reason == reason


@pytest.mark.parametrize("trip", [Fact.SOFT, Fact.HARD])
def test_a_trip_of_a_car_that_is_not_armed_is_a_failed_check(trip):
    car = Car().ready()
    car.facts |= trip
    car.text = "W1 mocap stale: no good frame for 170 ms"
    assert car.tick() == DISARMED
    assert car.memory.reason == car.text
    assert car.action.motor == MotorOutput.SILENT
    assert car.ticks(200) == DISARMED


def test_armed_for_30_s_without_a_start_disarms_and_keepalives_do_not_help():
    car = Car().armed()
    for _ in range(2999):
        assert car.tick(Request.KEEPALIVE) == ARMED
    assert car.tick(Request.KEEPALIVE) == DISARMED
    assert "30 s" in car.memory.reason


def test_start_needs_passing_checks_and_no_contradiction():
    for asked in (Request.STOP, Request.ABORT):
        assert Car().armed().tick(Request.START | asked) != RUNNING
    car = Car().armed()
    car.facts &= ~Fact.CHECKS_PASS
    assert car.tick(Request.START) == ARMED
    car.facts |= Fact.CHECKS_PASS
    assert car.tick(Request.START) == RUNNING
    assert car.action.cap == 0.5


@pytest.mark.parametrize("asked", [Request.DISARM, Request.UNKNOWN, 1 << 20])
def test_armed_leaves_on_disarm_on_unknown_requests_on_soft_trips_and_lost_leases(asked):
    assert Car().armed().tick(asked) == DISARMED
    for change in (lambda facts: facts | Fact.SOFT, lambda facts: facts & ~Fact.LEASED):
        car = Car().armed()
        car.facts = change(car.facts)
        assert car.tick() == DISARMED


def test_launch_window_caps_the_speed_until_the_checks_have_passed():
    car = Car().armed()
    car.tick(Request.START)
    assert (car.action.motor, car.action.steering, car.action.cap) == (
        MotorOutput.DRIVE,
        SteeringOutput.LIVE,
        0.5,
    )
    car.tick()
    assert car.action.cap == 0.5, "as long as they have not passed"
    car.facts |= Fact.LAUNCHED
    car.tick()
    assert car.action.cap == inf


def test_the_launch_checks_of_the_drive_before_lift_no_cap():
    car = Car().armed()
    car.facts |= Fact.LAUNCHED
    assert car.tick(Request.START) == RUNNING
    assert car.action.cap == 0.5
    car.tick()
    assert car.action.cap == inf
