"""The supervisor from RUNNING to a standstill: stops, faults, emergency stops."""

from math import nan

import pytest

from steerd.daemon.loop.supervisor import stands
from steerd.daemon.loop.transitions import (
    ARMED,
    DISARMED,
    ESTOP,
    FAULT_LATCHED,
    FAULT_STOP,
    RUNNING,
    STOPPING,
    Fact,
    MotorOutput,
    Request,
    SteeringOutput,
)
from tests.unit.daemon.loop.supervisor_rig import GOOD, Car


def test_stop_ramps_at_1_5_then_brakes_softly_and_arms_again():
    car = Car().running(2.0)
    assert car.tick(Request.STOP) == STOPPING
    assert (car.action.motor, car.action.cap) == (MotorOutput.RAMP_STOP, 2.0)
    car.speed = 1.0
    car.tick()
    assert car.action.cap == pytest.approx(1.985)
    assert car.outputs() == (MotorOutput.RAMP_STOP, SteeringOutput.LIVE)
    car.speed = 0.3
    car.tick()
    assert car.action.motor == MotorOutput.RAMP_STOP
    car.speed = 0.2999
    car.tick()
    assert car.action.motor == MotorOutput.SOFT_BRAKE
    car.speed = 0.5
    car.tick()
    assert car.action.motor == MotorOutput.SOFT_BRAKE  # no way back to the ramp
    car.speed = 0.0499
    assert car.ticks(30) == STOPPING
    assert car.tick() == ARMED
    assert car.tick(Request.START) == RUNNING


def test_ramp_ends_in_brake_current_when_the_cap_is_below_0_3_whatever_the_speed():
    car = Car().running(0.3)
    car.tick(Request.STOP)
    assert (car.action.cap, car.action.motor) == (0.3, MotorOutput.RAMP_STOP)
    car.tick()
    assert (car.action.cap >= 0.28, car.action.motor) == (True, MotorOutput.SOFT_BRAKE)


def test_stopping_without_knowing_the_speed_brakes_at_once():
    car = Car().running()
    car.speed = nan
    car.tick(Request.STOP)
    assert (car.action.motor, car.action.cap) == (MotorOutput.SOFT_BRAKE, 0.0)


def test_the_launch_cap_goes_on_into_the_stop():
    car = Car().armed()
    car.tick(Request.START)
    car.speed = 2.0
    car.tick(Request.STOP)
    assert car.action.cap == 0.5


@pytest.mark.parametrize("asked", [Request.DISARM, Request.UNKNOWN])
@pytest.mark.parametrize("late", [False, True])
def test_disarm_ends_in_disarmed_even_when_a_stop_came_first(asked, late):
    car = Car().running()
    if late:
        assert car.tick(Request.STOP) == STOPPING
    assert car.tick(asked) == STOPPING
    car.speed = 0.0
    assert car.until(DISARMED) >= 29


@pytest.mark.parametrize(("gained", "lost"), [(Fact.SOFT, 0), (0, Fact.LEASED)])
def test_a_trip_during_an_operators_stop_forbids_arming_again(gained, lost):
    car = Car().running()
    car.tick(Request.STOP)
    car.facts = (car.facts | gained) & ~lost
    car.tick()
    car.facts = GOOD
    car.speed = 0.0
    car.until(DISARMED)


@pytest.mark.parametrize(
    ("gained", "lost", "reason"),
    [(Fact.SOFT, 0, "W13 low"), (0, Fact.LEASED, "lease or deadman lost"),
     (Fact.ENDED, 0, "end of the run")],
)  # fmt: skip
def test_soft_reasons_stop_and_disarm(gained, lost, reason):
    car = Car().running()
    car.text = "W13 low"
    car.facts = (car.facts | gained) & ~lost
    assert car.tick() == STOPPING
    assert car.memory.reason == reason
    car.facts = GOOD
    car.speed = 0.0
    car.until(DISARMED)


def test_not_stopped_after_4_s_brakes_hard():
    car = Car().running()
    car.tick(Request.STOP)
    car.speed = 1.0
    assert car.ticks(399) == STOPPING
    assert car.tick() == FAULT_STOP
    assert car.action.motor == MotorOutput.BRAKE


@pytest.mark.parametrize("prepare", [Car.armed, Car.running])
@pytest.mark.parametrize(
    ("gained", "lost", "asked", "reason"),
    [
        (Fact.HARD, 0, 0, "W7 telemetry stale: no reply for 110 ms"),
        (0, Fact.LINKED, 0, "serial link lost"),
        (0, 0, Request.ABORT, "second signal: stopping hard"),
    ],
)
def test_hard_fault_brakes_in_the_same_tick_and_latches(prepare, gained, lost, asked, reason):
    car = prepare(Car())
    car.text = "W7 telemetry stale: no reply for 110 ms"
    car.facts = (car.facts | gained) & ~lost
    assert car.tick(asked) == FAULT_STOP
    assert car.action.motor == MotorOutput.BRAKE
    assert car.memory.reason == reason
    car.text = "W1 another"
    car.speed = 0.0
    car.until(FAULT_LATCHED)
    assert car.memory.reason == reason
    assert car.outputs() == (MotorOutput.RELEASE_ONCE, SteeringOutput.CENTRE)
    car.tick()
    assert car.action.motor == MotorOutput.SILENT
    car.ticks(48)
    assert car.action.steering == SteeringOutput.CENTRE
    car.tick()
    assert car.action.steering == SteeringOutput.NONE


def test_a_trip_without_text_still_has_a_reason():
    car = Car().running()
    car.facts |= Fact.HARD
    car.tick()
    assert car.memory.reason == "a watchdog tripped"


def test_fault_stop_steers_while_the_estimate_is_good_and_holds_otherwise():
    car = Car().running()
    car.facts |= Fact.HARD
    car.tick()
    assert car.action.steering == SteeringOutput.LIVE
    car.facts &= ~Fact.ESTIMATED
    car.tick()
    assert car.action.steering == SteeringOutput.HOLD
    car.facts &= ~Fact.SLOWING
    car.tick()
    assert car.action.motor == MotorOutput.DUTY_ZERO


def test_fault_stop_gives_up_after_2_s_only_if_no_source_gives_the_speed():
    car = Car().running()
    car.facts |= Fact.HARD
    car.speed = nan
    car.tick()
    assert car.ticks(199) == FAULT_STOP
    assert car.tick() == FAULT_LATCHED
    car = Car().running()
    car.facts |= Fact.HARD
    car.speed = 0.05
    assert car.ticks(1000) == FAULT_STOP


def test_latched_fault_clears_only_standing_with_the_cause_gone_and_by_an_operator():
    car = Car().running()
    car.facts |= Fact.HARD
    car.tick()
    car.speed = 0.0
    car.until(FAULT_LATCHED)
    assert car.tick(Request.CLEAR) == FAULT_LATCHED
    car.facts = GOOD | Fact.SOFT
    assert car.tick(Request.CLEAR) == FAULT_LATCHED
    car.facts = GOOD
    assert car.ticks(100) == FAULT_LATCHED
    car.speed = 0.05
    assert car.tick(Request.CLEAR) == FAULT_LATCHED
    car.speed = 0.0
    car.ticks(30)
    assert car.tick(Request.ARM | Request.START) == FAULT_LATCHED
    assert car.tick(Request.CLEAR) == DISARMED


def test_estop_brakes_at_least_2_s_then_is_silent_until_reset():
    car = Car().running()
    assert car.tick(Request.ESTOP | Request.START) == ESTOP
    assert car.outputs() == (MotorOutput.ESTOP_BRAKE, SteeringOutput.LIVE)
    car.facts &= ~(Fact.SLOWING | Fact.ESTIMATED)
    car.tick()
    assert car.outputs() == (MotorOutput.DUTY_ZERO, SteeringOutput.HOLD)
    car.facts = GOOD
    car.speed = 0.0
    assert car.tick(Request.RESET) == ESTOP
    car.ticks(30)
    assert car.action.steering == SteeringOutput.CENTRE
    car.ticks(167)
    assert car.action.motor == MotorOutput.ESTOP_BRAKE
    car.tick()
    assert car.outputs() == (MotorOutput.SILENT, SteeringOutput.NONE)
    assert car.tick(Request.CLEAR | Request.ARM | Request.START) == ESTOP
    car.facts |= Fact.KILLED
    assert car.tick(Request.RESET) == ESTOP
    car.facts = GOOD | Fact.HARD
    assert car.tick(Request.RESET) == ESTOP
    car.facts = GOOD
    assert car.tick(Request.RESET) == DISARMED


def test_estop_takes_2_s_without_a_speed_as_standing():
    car = Car().running()
    car.tick(Request.ESTOP)
    car.speed = nan
    assert car.ticks(199) == ESTOP
    assert car.action.motor == MotorOutput.ESTOP_BRAKE
    assert not stands(car.memory, car.t_ns)
    car.tick()
    assert stands(car.memory, car.t_ns)
    assert car.action.motor == MotorOutput.SILENT
    car.speed = 0.05
    car.tick()
    assert not stands(car.memory, car.t_ns), "it rolls, as is seen now"
    assert car.tick(Request.RESET) == ESTOP


def test_estop_goes_on_braking_while_the_car_moves():
    car = Car().running()
    car.tick(Request.ESTOP)
    car.ticks(500)
    assert car.action.motor == MotorOutput.ESTOP_BRAKE


def test_an_unidentified_vesc_gets_its_brake_frames_again():
    car = Car().ready()
    car.facts &= ~Fact.IDENTIFIED
    motors = []
    for _ in range(5):
        car.tick()
        motors.append(car.action.motor)
    assert motors == [MotorOutput.SOFT_BRAKE] * 3 + [MotorOutput.SILENT] * 2


@pytest.mark.parametrize("speed", [0.05, -0.05])
def test_five_centimetres_a_second_is_not_standing(speed):
    car = Car().running()
    car.tick(Request.STOP)
    car.speed = speed
    assert car.ticks(100) == STOPPING
