"""Stories through the state machine, tick by tick, with each duration met exactly."""

from math import inf, nan

import pytest

from steerd.daemon.loop import supervisor as sv
from steerd.daemon.loop.transitions import Fact, MotorOutput, SteeringOutput, SupervisorState

(INIT, DISARMED, READY, SELF_TEST, ARMED, RUNNING, STOPPING,
 FAULT_STOP, FAULT_LATCHED, ESTOP) = SupervisorState  # fmt: skip
MS = 1_000_000
GOOD = (
    Fact.LINKED | Fact.IDENTIFIED | Fact.CHECKS_PASS | Fact.LEASED | Fact.ESTIMATED | Fact.SLOWING
)
TIMEOUT_NS = 150 * MS


class Car:
    """A supervisor with conditions that a test turns on and off."""

    def __init__(self):
        self.t_ns, self.facts, self.speed, self.text = 0, GOOD | Fact.FW_TIMEOUT, 0.0, ""
        self.memory = sv.make_supervisor_memory(0)
        self.action = None

    def tick(self, requests=0, dt=10 * MS, **changes):
        """One tick; `facts` and `speed` hold from it on."""
        vars(self).update(changes)
        self.t_ns += dt
        conditions = sv.Conditions(int(self.facts), self.speed, TIMEOUT_NS, self.text)
        self.memory, self.action = sv.step_supervisor(self.memory, conditions, requests, self.t_ns)
        return self.memory.state

    def ticks(self, count, dt=10 * MS):
        return [self.tick(dt=dt) for _ in range(count)][-1]

    def motors(self, count=5):
        for _ in range(count):
            self.tick()
            yield self.action.motor

    def outputs(self):
        return self.action.motor, self.action.steering

    def motor_at(self, speed):
        self.tick(speed=speed)
        return self.action.motor

    def until(self, state, limit=1000):
        for count in range(limit):
            if self.tick() == state:
                return count
        raise AssertionError(f"stayed in {self.memory.state.name}: {self.action}")

    def parked(self):
        self.until(DISARMED)
        return self

    def ready(self):
        self.until(READY)
        return self

    def testing(self):
        self.ready().tick(Fact.ARM)
        return self

    def armed(self):
        self.testing().until(ARMED)
        self.facts &= ~Fact.FW_TIMEOUT
        return self

    def running(self, speed=2.0):
        self.armed().tick(Fact.START)
        assert self.tick(facts=self.facts | Fact.LAUNCHED, speed=speed) == RUNNING
        return self


def test_it_begins_with_nothing_shown_nothing_held_and_no_speed():
    begun = sv.make_supervisor_memory(5)
    expected = sv.SupervisorMemory(
        INIT, 5, 5, "started", sv.NEVER, sv.NEVER, sv.NEVER, 0.0, False, False, sv.OPEN_FRAMES
    )
    assert (begun, repr(begun)) == (expected, repr(expected)), "of the same types too"
    assert (sv.NEVER, sv.OPEN_FRAMES) == (-1, 3)


BRAKED_THEN_SILENT = [MotorOutput.SOFT_BRAKE] * 3 + [MotorOutput.SILENT] * 2


def test_opening_the_port_brakes_three_times_then_is_silent():
    car = Car()
    car.facts = 0
    assert list(car.motors(3)) == [MotorOutput.SILENT] * 3
    assert car.memory.state == INIT
    car.facts = Fact.LINKED
    assert list(car.motors()) == BRAKED_THEN_SILENT
    car.tick(facts=0)
    car.facts = GOOD
    assert list(car.motors(3)) == BRAKED_THEN_SILENT[:3]
    assert car.memory.state == INIT
    assert car.tick() == DISARMED
    car.facts &= ~Fact.IDENTIFIED
    assert list(car.motors()) == BRAKED_THEN_SILENT


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
    assert sv.WAITING[car.memory.state] == "arm"


def fail_a_check(car):
    car.tick(facts=car.facts & ~Fact.CHECKS_PASS)
    car.facts |= Fact.CHECKS_PASS


@pytest.mark.parametrize(("interrupt", "left"), [
    (fail_a_check, 100), (lambda car: car.tick(dt=101 * MS), 100),
    (lambda car: car.tick(dt=-5000 * MS), 100), (lambda car: car.tick(dt=0), 50),
    (lambda car: car.tick(dt=100 * MS), 40),
], ids=["a failed check", "a gap between ticks", "a clock that runs backwards", "no time",
        "a tenth of a second is no gap"])  # fmt: skip
def test_what_starts_the_second_of_passing_checks_again(interrupt, left):
    car = Car()
    car.until(DISARMED)
    car.ticks(50)
    interrupt(car)
    assert car.memory.state == DISARMED
    assert car.ticks(left) == DISARMED
    assert car.tick() == READY


def test_arming_is_silent_until_the_timeout_has_shown_for_210_ms():
    car = Car().ready()
    assert car.tick(Fact.ARM) == SELF_TEST
    for _ in range(21):
        assert car.tick() == SELF_TEST
        assert car.outputs() == (MotorOutput.SILENT, SteeringOutput.NONE)
    assert car.tick() == ARMED
    assert car.outputs() == (MotorOutput.HOLD_BRAKE, SteeringOutput.CENTRE)
    assert car.memory.reason == "VESC's timeout proven"


@pytest.mark.parametrize("rises", [True, False])
def test_timeout_bit_may_rise_as_late_as_its_timeout_plus_50_ms(rises):
    car = Car().ready()
    car.tick(Fact.ARM, facts=GOOD)
    assert car.ticks(19) == SELF_TEST
    if rises:
        car.facts |= Fact.FW_TIMEOUT
        assert car.ticks(21) == SELF_TEST
    assert car.tick() == (ARMED if rises else DISARMED)
    assert rises or "Close VESC Tool" in car.memory.reason


def test_another_programs_alive_every_200_ms_is_found():
    car = Car().testing()
    for k in range(60):  # 150 ms fed, 50 ms timed out, and so on
        assert car.tick(facts=GOOD | Fact.FW_TIMEOUT * (k % 20 >= 15)) != ARMED
    assert car.memory.state == DISARMED


CALLED_OFF = (Fact.STOP, Fact.DISARM, Fact.ABORT, Fact.UNKNOWN)


@pytest.mark.parametrize(("begin", "gained", "lost", "asked", "state", "reason"), [
    *((begin, 0, missing, 0, INIT, "") for begin in (Car.parked, Car.ready)
      for missing in (Fact.LINKED, Fact.IDENTIFIED)),
    *((Car.ready, 0, 0, Fact.ARM | no, READY, "") for no in (*CALLED_OFF, 1 << 12)),
    (Car.ready, 0, Fact.LEASED, Fact.ARM, READY, ""),
    *((Car.testing, 0, 0, no, DISARMED, "arming called off") for no in CALLED_OFF),
    (Car.testing, 0, Fact.LEASED, 0, DISARMED, "lease or deadman lost"),
    (Car.testing, 0, Fact.CHECKS_PASS, 0, DISARMED, "a pre-arm check failed"),
    *((begin, trip, 0, 0, DISARMED, "W1 mocap stale") for begin in (Car.ready, Car.testing)
      for trip in (Fact.SOFT, Fact.HARD)),
    (Car.armed, 0, Fact.CHECKS_PASS, Fact.START, ARMED, ""),
    (Car.armed, 0, 0, Fact.START | Fact.STOP, ARMED, ""),
    (Car.armed, 0, 0, Fact.START | Fact.ABORT, FAULT_STOP, ""),
    *((Car.armed, 0, 0, no, DISARMED, "") for no in (Fact.DISARM, Fact.UNKNOWN, 1 << 27)),
    (Car.armed, Fact.SOFT, 0, 0, DISARMED, "W1 mocap stale"),
    (Car.armed, 0, Fact.LEASED, 0, DISARMED, "lease or deadman lost"),
])  # fmt: skip
def test_what_keeps_a_car_from_arming_and_starting(begin, gained, lost, asked, state, reason):
    car = begin(Car())
    car.facts, car.text = (car.facts | gained) & ~lost, "W1 mocap stale"
    assert car.tick(asked) == state
    assert reason in car.memory.reason
    if gained and begin is not Car.armed:
        assert (car.action.motor, car.ticks(200)) == (MotorOutput.SILENT, DISARMED)


def test_armed_for_30_s_without_a_start_disarms_and_keepalives_do_not_help():
    car = Car().armed()
    assert car.ticks(2999) == ARMED
    assert car.tick() == DISARMED
    assert "30 s" in car.memory.reason


@pytest.mark.parametrize("before", [0, Fact.LAUNCHED], ids=["", "those of the drive before"])
def test_launch_window_caps_the_speed_until_the_checks_have_passed(before):
    car = Car().armed()
    car.facts |= before
    car.tick(Fact.START)
    assert (*car.outputs(), car.action.cap) == (MotorOutput.DRIVE, SteeringOutput.LIVE, 0.5)
    car.tick()
    assert car.action.cap == (inf if before else 0.5)
    car.tick(facts=car.facts | Fact.LAUNCHED)
    assert car.action.cap == inf


# The supervisor from RUNNING to a standstill: stops, faults, emergency stops.
def test_stop_ramps_at_1_5_then_brakes_softly_and_arms_again():
    car = Car().running(2.0)
    assert car.tick(Fact.STOP) == STOPPING
    assert (car.action.motor, car.action.cap) == (MotorOutput.RAMP_STOP, 2.0)
    car.tick(speed=1.0)
    assert car.action.cap == pytest.approx(1.985)
    car.tick(dt=-20 * MS)
    assert car.action.cap == pytest.approx(1.985), "nor does a clock that runs backwards raise it"
    assert car.outputs() == (MotorOutput.RAMP_STOP, SteeringOutput.LIVE)
    assert car.motor_at(0.3) == MotorOutput.RAMP_STOP
    assert car.motor_at(0.2999) == MotorOutput.SOFT_BRAKE
    assert car.motor_at(0.5) == MotorOutput.SOFT_BRAKE, "no way back to the ramp"
    car.speed = 0.0499
    assert car.ticks(30) == STOPPING
    assert car.tick() == ARMED
    assert car.tick(Fact.START) == RUNNING


def test_ramp_ends_in_brake_current_when_the_cap_is_below_0_3_whatever_the_speed():
    car = Car().running(0.3)
    car.tick(Fact.STOP)
    assert (car.action.cap, car.action.motor) == (0.3, MotorOutput.RAMP_STOP)
    car.tick()
    assert (car.action.cap >= 0.28, car.action.motor) == (True, MotorOutput.SOFT_BRAKE)


def test_a_stop_of_unknown_speed_brakes_at_once_and_a_launch_stops_from_its_cap():
    for speed, *expected in ((nan, MotorOutput.SOFT_BRAKE, 0.0), (2.0, MotorOutput.RAMP_STOP, 0.5)):
        car = Car().armed()
        car.tick(Fact.START)
        car.tick(Fact.STOP, speed=speed)
        assert [car.action.motor, car.action.cap] == expected


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(("gained", "lost", "asked", "reason"), [
    (Fact.SOFT, 0, 0, "W13 low"), (0, Fact.LEASED, 0, "lease or deadman lost"),
    (Fact.ENDED, 0, 0, "end of the run"), (0, 0, Fact.DISARM, "disarm asked for"),
    (0, 0, Fact.UNKNOWN, "disarm asked for"),
])  # fmt: skip
def test_a_stop_that_no_operator_asked_for_ends_disarmed(gained, lost, asked, reason, late):
    """Also one that comes up during an operator's; the end of the run does not spoil that."""
    car = Car().running()
    car.text = "W13 low"
    if late:
        car.tick(Fact.STOP)
    assert car.tick(asked, facts=(car.facts | gained) & ~lost) == STOPPING
    assert car.memory.reason == ("stop asked for" if late else reason)
    car.facts, car.speed = GOOD, 0.0
    assert car.until(ARMED if late and gained == Fact.ENDED else DISARMED) >= 29


def test_not_stopped_after_4_s_brakes_hard():
    car = Car().running()
    car.tick(Fact.STOP)
    car.speed = 1.0
    assert car.ticks(399) == STOPPING
    assert car.tick() == FAULT_STOP
    assert car.action.motor == MotorOutput.BRAKE


@pytest.mark.parametrize("prepare", [Car.armed, Car.running])
@pytest.mark.parametrize(("gained", "lost", "asked", "reason"), [
    (Fact.HARD, 0, 0, "W7 telemetry stale: no reply for 110 ms"),
    (0, Fact.LINKED, 0, "serial link lost"), (0, 0, Fact.ABORT, "second signal: stopping hard"),
])  # fmt: skip
def test_hard_fault_brakes_in_the_same_tick_and_latches(prepare, gained, lost, asked, reason):
    car = prepare(Car())
    car.text = "W7 telemetry stale: no reply for 110 ms"
    assert car.tick(asked, facts=(car.facts | gained) & ~lost) == FAULT_STOP
    assert car.action.motor == MotorOutput.BRAKE
    assert car.memory.reason == reason
    car.text, car.speed = "W1 another", 0.0
    car.until(FAULT_LATCHED)
    assert car.memory.reason == reason
    assert car.outputs() == (MotorOutput.RELEASE_ONCE, SteeringOutput.CENTRE)
    car.tick()
    assert car.action.motor == MotorOutput.SILENT
    car.ticks(48)
    assert car.action.steering == SteeringOutput.CENTRE
    car.tick()
    assert car.action.steering == SteeringOutput.NONE


def test_fault_stop_steers_while_the_estimate_is_good_and_holds_otherwise():
    car = Car().running()
    car.tick(facts=car.facts | Fact.HARD)
    assert car.action.steering == SteeringOutput.LIVE
    assert car.memory.reason == "a watchdog tripped", "without a text"
    car.tick(facts=car.facts & ~Fact.ESTIMATED)
    assert car.action.steering == SteeringOutput.HOLD
    car.tick(facts=car.facts & ~Fact.SLOWING)
    assert car.action.motor == MotorOutput.DUTY_ZERO


def test_fault_stop_gives_up_after_2_s_only_if_no_source_gives_the_speed():
    given = ((nan, 1, FAULT_LATCHED), (0.05, 801, FAULT_STOP), (-0.05, 801, FAULT_STOP))
    for speed, more, end in given:  # 0.05 m/s is not standing
        car = Car().running()
        car.tick(facts=car.facts | Fact.HARD, speed=speed)
        assert car.ticks(199) == FAULT_STOP
        assert car.ticks(more) == end


def test_latched_fault_clears_only_standing_with_the_cause_gone_and_by_an_operator():
    car = Car().running()
    car.tick(facts=car.facts | Fact.HARD)
    car.speed = 0.0
    car.until(FAULT_LATCHED)
    assert car.tick(Fact.CLEAR) == FAULT_LATCHED
    assert car.tick(Fact.CLEAR, facts=GOOD | Fact.SOFT) == FAULT_LATCHED
    car.facts = GOOD
    assert car.ticks(100) == FAULT_LATCHED
    assert car.tick(Fact.CLEAR, speed=0.05) == FAULT_LATCHED
    car.speed = 0.0
    car.ticks(30)
    assert car.tick(Fact.ARM | Fact.START) == FAULT_LATCHED
    assert car.tick(Fact.CLEAR) == DISARMED


def test_estop_brakes_at_least_2_s_then_is_silent_until_reset():
    car = Car().running()
    assert car.tick(Fact.CALL_ESTOP | Fact.START) == ESTOP
    assert car.outputs() == (MotorOutput.ESTOP_BRAKE, SteeringOutput.LIVE)
    car.tick(facts=car.facts & ~(Fact.SLOWING | Fact.ESTIMATED))
    assert car.outputs() == (MotorOutput.DUTY_ZERO, SteeringOutput.HOLD)
    assert car.tick(Fact.RESET, facts=GOOD, speed=0.0) == ESTOP
    car.ticks(30)
    assert car.action.steering == SteeringOutput.CENTRE
    car.ticks(167)
    assert car.action.motor == MotorOutput.ESTOP_BRAKE
    car.tick()
    assert car.outputs() == (MotorOutput.SILENT, SteeringOutput.NONE)
    assert car.tick(Fact.CLEAR | Fact.ARM | Fact.START) == ESTOP
    for trip in (Fact.KILLED, Fact.HARD):
        assert car.tick(Fact.RESET, facts=GOOD | trip) == ESTOP
    assert car.tick(Fact.RESET, facts=GOOD) == DISARMED


def test_estop_takes_2_s_without_a_speed_as_standing():
    car = Car().running()
    car.tick(Fact.CALL_ESTOP)
    car.speed = nan
    assert car.ticks(199) == ESTOP
    assert car.action.motor == MotorOutput.ESTOP_BRAKE
    assert not sv.stands(car.memory, car.t_ns)
    car.tick()
    assert sv.stands(car.memory, car.t_ns)
    assert car.action.motor == MotorOutput.SILENT
    car.tick(speed=0.05)
    assert not sv.stands(car.memory, car.t_ns), "it rolls, as is seen now"
    car.ticks(300)
    assert car.action.motor == MotorOutput.ESTOP_BRAKE, "for as long as it moves"
    assert car.tick(Fact.RESET) == ESTOP
