"""Stories through the state machine, tick by tick, with each duration met exactly."""

from math import inf, nan

import pytest

from steerd.daemon.loop.supervisor import Conditions, make_supervisor_memory, step_supervisor
from steerd.daemon.loop.transitions import (
    Fact,
    MotorOutput,
    Request,
    SteeringOutput,
    SupervisorState,
)

MS = 1_000_000
GOOD = (
    Fact.LINKED | Fact.IDENTIFIED | Fact.CHECKS_PASS | Fact.LEASED | Fact.ESTIMATED | Fact.SLOWING
)
TIMEOUT_NS = 150 * MS


class Car:
    """A supervisor with conditions that a test turns on and off."""

    def __init__(self):
        self.t_ns, self.facts, self.speed, self.text = 0, GOOD | Fact.FW_TIMEOUT, 0.0, ""
        self.memory = make_supervisor_memory(0)
        self.action = None

    def tick(self, requests=0, dt=10 * MS):
        self.t_ns += dt
        conditions = Conditions(int(self.facts), self.speed, TIMEOUT_NS, self.text)
        self.memory, self.action = step_supervisor(self.memory, conditions, requests, self.t_ns)
        return self.memory.state

    def ticks(self, count, dt=10 * MS):
        return [self.tick(dt=dt) for _ in range(count)][-1]

    def until(self, state, limit=1000):
        for count in range(limit):
            if self.tick() == state:
                return count
        raise AssertionError(f"stayed in {self.memory.state.name}: {self.action}")

    def ready(self):
        self.until(SupervisorState.READY)
        return self

    def armed(self):
        self.ready().tick(Request.ARM)
        self.until(SupervisorState.ARMED)
        self.facts &= ~Fact.FW_TIMEOUT
        return self

    def running(self, speed=2.0):
        self.armed().tick(Request.START)
        self.facts |= Fact.LAUNCHED
        self.speed = speed
        self.tick()
        assert self.memory.state == SupervisorState.RUNNING
        return self


def test_opening_the_port_brakes_three_times_then_is_silent():
    car = Car()
    car.facts = Fact(0)
    assert [car.tick() for _ in range(3)] == [SupervisorState.INIT] * 3
    assert car.action.motor == MotorOutput.SILENT
    car.facts = Fact.LINKED
    motors = []
    for _ in range(5):
        car.tick()
        motors.append(car.action.motor)
    assert motors == [MotorOutput.SOFT_BRAKE] * 3 + [MotorOutput.SILENT] * 2
    car.facts = Fact(0)
    car.tick()
    car.facts = GOOD
    motors = []
    while car.tick() == SupervisorState.INIT:
        motors.append(car.action.motor)
    assert motors == [MotorOutput.SOFT_BRAKE] * 3
    assert car.memory.state == SupervisorState.DISARMED


def test_disarmed_centres_for_half_a_second_and_needs_green_for_one():
    car = Car()
    car.until(SupervisorState.DISARMED)
    assert (car.action.motor, car.action.steering) == (MotorOutput.SILENT, SteeringOutput.CENTRE)
    car.ticks(49)
    assert car.action.steering == SteeringOutput.CENTRE
    car.tick()
    assert car.action.steering == SteeringOutput.NONE
    assert car.ticks(50) == SupervisorState.DISARMED
    assert car.tick() == SupervisorState.READY  # 1.00 s after the first tick in DISARMED
    assert car.action.waiting == "arm"


def test_a_flicker_of_red_starts_the_second_again():
    car = Car()
    car.until(SupervisorState.DISARMED)
    car.ticks(99)
    car.facts &= ~Fact.CHECKS_PASS
    car.tick()
    car.facts |= Fact.CHECKS_PASS
    assert car.ticks(100) == SupervisorState.DISARMED
    assert car.tick() == SupervisorState.READY


def test_nobody_looking_for_long_proves_nothing():
    car = Car()
    car.until(SupervisorState.DISARMED)
    car.tick(dt=100 * MS)
    assert car.tick(dt=101 * MS) == SupervisorState.DISARMED
    assert car.ticks(100) == SupervisorState.DISARMED
    assert car.tick() == SupervisorState.READY


def test_a_tenth_of_a_second_between_ticks_still_counts():
    car = Car()
    car.until(SupervisorState.DISARMED)
    assert car.ticks(10, dt=100 * MS) == SupervisorState.DISARMED
    assert car.tick(dt=100 * MS) == SupervisorState.READY


def test_clock_running_backwards_never_lifts_a_state():
    car = Car()
    car.until(SupervisorState.DISARMED)
    assert car.tick(dt=-5000 * MS) == SupervisorState.DISARMED
    assert car.ticks(100) == SupervisorState.DISARMED
    assert car.tick() == SupervisorState.READY


@pytest.mark.parametrize("missing", [Fact.LINKED, Fact.IDENTIFIED])
def test_quiet_states_fall_back_to_init_without_the_vesc(missing):
    for prepare in (lambda c: c.until(SupervisorState.DISARMED), Car.ready):
        car = Car()
        prepare(car)
        car.facts &= ~missing
        assert car.tick() == SupervisorState.INIT
        car.facts |= missing
        car.until(SupervisorState.DISARMED)


def test_arming_is_silent_until_the_timeout_has_shown_for_210_ms():
    car = Car().ready()
    assert car.tick(Request.ARM) == SupervisorState.SELF_TEST
    for _ in range(21):
        assert car.tick() == SupervisorState.SELF_TEST
        assert (car.action.motor, car.action.steering) == (MotorOutput.SILENT, SteeringOutput.NONE)
    assert car.tick() == SupervisorState.ARMED
    assert (car.action.motor, car.action.steering) == (
        MotorOutput.HOLD_BRAKE,
        SteeringOutput.CENTRE,
    )
    assert car.action.reason == "VESC's timeout proven"


def test_timeout_bit_that_never_rises_refuses_to_arm_and_says_why():
    car = Car().ready()
    car.facts &= ~Fact.FW_TIMEOUT
    car.tick(Request.ARM)
    assert car.ticks(19) == SupervisorState.SELF_TEST
    assert car.tick() == SupervisorState.DISARMED  # timeout 150 ms + 50 ms
    assert "Close VESC Tool" in car.action.reason


def test_timeout_bit_may_rise_as_late_as_its_timeout_plus_50_ms():
    car = Car().ready()
    car.facts &= ~Fact.FW_TIMEOUT
    car.tick(Request.ARM)
    car.ticks(19)
    car.facts |= Fact.FW_TIMEOUT
    assert car.ticks(21) == SupervisorState.SELF_TEST
    assert car.tick() == SupervisorState.ARMED


def test_someone_elses_alive_every_200_ms_is_found_though_the_bit_does_rise():
    car = Car().ready()
    car.tick(Request.ARM)
    seen = set()
    for k in range(60):  # 150 ms fed, 50 ms timed out, and so on
        car.facts = (
            (car.facts | Fact.FW_TIMEOUT) if k % 20 >= 15 else (car.facts & ~Fact.FW_TIMEOUT)
        )
        seen.add(car.tick())
    assert SupervisorState.ARMED not in seen
    assert car.memory.state == SupervisorState.DISARMED


def test_arm_needs_a_lease_and_nobody_saying_stop():
    for asked in (Request.STOP, Request.DISARM, Request.ABORT, Request.UNKNOWN, 1 << 12):
        assert Car().ready().tick(int(Request.ARM) | int(asked)) == SupervisorState.READY
    car = Car().ready()
    car.facts &= ~Fact.LEASED
    assert car.tick(Request.ARM) == SupervisorState.READY


@pytest.mark.parametrize("asked", [Request.STOP, Request.DISARM, Request.ABORT, Request.UNKNOWN])
def test_self_test_can_be_called_off(asked):
    car = Car().ready()
    car.tick(Request.ARM)
    assert car.tick(asked) == SupervisorState.DISARMED
    assert car.action.reason == "arming called off"


@pytest.mark.parametrize(
    ("gone", "reason"),
    [(Fact.LEASED, "lease or deadman lost"), (Fact.CHECKS_PASS, "a pre-arm check failed")],
)
def test_self_test_ends_with_its_conditions(gone, reason):
    car = Car().ready()
    car.tick(Request.ARM)
    car.facts &= ~gone
    assert car.tick() == SupervisorState.DISARMED
    assert car.action.reason == reason


@pytest.mark.parametrize("trip", [Fact.SOFT, Fact.HARD])
def test_a_trip_of_a_car_that_is_not_armed_is_a_red_check(trip):
    car = Car().ready()
    car.facts |= trip
    car.text = "W1 mocap stale: no good frame for 170 ms"
    assert car.tick() == SupervisorState.DISARMED
    assert car.action.reason == car.text
    assert car.action.motor == MotorOutput.SILENT
    assert car.ticks(200) == SupervisorState.DISARMED


def test_armed_for_30_s_without_a_start_disarms_and_keepalives_do_not_help():
    car = Car().armed()
    for _ in range(2999):
        assert car.tick(Request.KEEPALIVE) == SupervisorState.ARMED
    assert car.tick(Request.KEEPALIVE) == SupervisorState.DISARMED
    assert "30 s" in car.action.reason


def test_start_needs_green_and_no_contradiction():
    for asked in (Request.STOP, Request.ABORT):
        assert Car().armed().tick(Request.START | asked) != SupervisorState.RUNNING
    car = Car().armed()
    car.facts &= ~Fact.CHECKS_PASS
    assert car.tick(Request.START) == SupervisorState.ARMED
    car.facts |= Fact.CHECKS_PASS
    assert car.tick(Request.START) == SupervisorState.RUNNING
    assert car.action.cap == 0.5


@pytest.mark.parametrize("asked", [Request.DISARM, Request.UNKNOWN, 1 << 20])
def test_armed_leaves_on_disarm_and_on_what_nobody_knows(asked):
    assert Car().armed().tick(asked) == SupervisorState.DISARMED


def test_armed_disarms_on_soft_trips_and_lost_leases():
    car = Car().armed()
    car.facts |= Fact.SOFT
    assert car.tick() == SupervisorState.DISARMED
    car = Car().armed()
    car.facts &= ~Fact.LEASED
    assert car.tick() == SupervisorState.DISARMED


def test_launch_window_caps_the_speed_until_the_checks_have_passed():
    car = Car().armed()
    car.tick(Request.START)
    assert (car.action.motor, car.action.steering, car.action.cap) == (
        MotorOutput.DRIVE,
        SteeringOutput.LIVE,
        0.5,
    )
    car.facts |= Fact.LAUNCHED
    car.tick()
    assert car.action.cap == inf


def test_the_launch_checks_of_the_drive_before_lift_no_cap():
    car = Car().armed()
    car.facts |= Fact.LAUNCHED
    assert car.tick(Request.START) == SupervisorState.RUNNING
    assert car.action.cap == 0.5
    car.tick()
    assert car.action.cap == inf


def test_stop_ramps_at_1_5_then_brakes_softly_and_arms_again():
    car = Car().running(2.0)
    assert car.tick(Request.STOP) == SupervisorState.STOPPING
    assert (car.action.motor, car.action.cap) == (MotorOutput.RAMP_STOP, 2.0)
    car.speed = 1.0
    car.tick()
    assert car.action.cap == pytest.approx(1.985)
    assert (car.action.motor, car.action.steering) == (MotorOutput.RAMP_STOP, SteeringOutput.LIVE)
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
    assert car.ticks(30) == SupervisorState.STOPPING
    assert car.tick() == SupervisorState.ARMED
    assert car.tick(Request.START) == SupervisorState.RUNNING


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
        assert car.tick(Request.STOP) == SupervisorState.STOPPING
    assert car.tick(asked) == SupervisorState.STOPPING
    car.speed = 0.0
    assert car.until(SupervisorState.DISARMED) >= 29


@pytest.mark.parametrize("change", ["soft", "lease"])
def test_a_trip_during_an_operators_stop_forbids_arming_again(change):
    car = Car().running()
    car.tick(Request.STOP)
    car.facts = car.facts | Fact.SOFT if change == "soft" else car.facts & ~Fact.LEASED
    car.tick()
    car.facts = GOOD
    car.speed = 0.0
    car.until(SupervisorState.DISARMED)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda c: setattr(c, "facts", c.facts | Fact.SOFT), "W13 low"),
        (lambda c: setattr(c, "facts", c.facts & ~Fact.LEASED), "lease or deadman lost"),
        (lambda c: setattr(c, "facts", c.facts | Fact.ENDED), "end of the run"),
    ],
)
def test_soft_reasons_stop_and_disarm(change, reason):
    car = Car().running()
    car.text = "W13 low"
    change(car)
    assert car.tick() == SupervisorState.STOPPING
    assert car.action.reason == reason
    car.facts = GOOD
    car.speed = 0.0
    car.until(SupervisorState.DISARMED)


def test_not_stopped_after_4_s_brakes_hard():
    car = Car().running()
    car.tick(Request.STOP)
    car.speed = 1.0
    assert car.ticks(399) == SupervisorState.STOPPING
    assert car.tick() == SupervisorState.FAULT_STOP
    assert car.action.motor == MotorOutput.BRAKE


@pytest.mark.parametrize("prepare", [Car.armed, Car.running])
@pytest.mark.parametrize("fault", ["hard", "link", "abort"])
def test_hard_fault_brakes_in_the_same_tick_and_latches(prepare, fault):
    car = prepare(Car())
    car.text = "W7 telemetry stale: no reply for 110 ms"
    if fault == "hard":
        car.facts |= Fact.HARD
    elif fault == "link":
        car.facts &= ~Fact.LINKED
    assert car.tick(Request.ABORT if fault == "abort" else 0) == SupervisorState.FAULT_STOP
    assert car.action.motor == MotorOutput.BRAKE
    reason = car.action.reason
    assert (
        reason
        == {
            "hard": car.text,
            "link": "serial link lost",
            "abort": "second signal: stopping hard",
        }[fault]
    )
    car.text = "W1 another"
    car.speed = 0.0
    car.until(SupervisorState.FAULT_LATCHED)
    assert car.action.reason == reason
    assert (car.action.motor, car.action.steering) == (
        MotorOutput.RELEASE_ONCE,
        SteeringOutput.CENTRE,
    )
    car.tick()
    assert car.action.motor == MotorOutput.SILENT
    car.ticks(48)
    assert car.action.steering == SteeringOutput.CENTRE
    car.tick()
    assert car.action.steering == SteeringOutput.NONE


def test_a_trip_without_words_still_has_a_reason():
    car = Car().running()
    car.facts |= Fact.HARD
    car.tick()
    assert car.action.reason == "a watchdog tripped"


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


def test_fault_stop_gives_up_after_2_s_only_if_no_source_tells_the_speed():
    car = Car().running()
    car.facts |= Fact.HARD
    car.speed = nan
    car.tick()
    assert car.ticks(199) == SupervisorState.FAULT_STOP
    assert car.tick() == SupervisorState.FAULT_LATCHED
    car = Car().running()
    car.facts |= Fact.HARD
    car.speed = 0.05
    assert car.ticks(1000) == SupervisorState.FAULT_STOP


def test_latched_fault_clears_only_standing_with_the_cause_gone_and_by_an_operator():
    car = Car().running()
    car.facts |= Fact.HARD
    car.tick()
    car.speed = 0.0
    car.until(SupervisorState.FAULT_LATCHED)
    assert car.tick(Request.CLEAR) == SupervisorState.FAULT_LATCHED
    car.facts = GOOD | Fact.SOFT
    assert car.tick(Request.CLEAR) == SupervisorState.FAULT_LATCHED
    car.facts = GOOD
    assert car.ticks(100) == SupervisorState.FAULT_LATCHED
    car.speed = 0.05
    assert car.tick(Request.CLEAR) == SupervisorState.FAULT_LATCHED
    car.speed = 0.0
    car.ticks(30)
    assert car.tick(Request.ARM | Request.START) == SupervisorState.FAULT_LATCHED
    assert car.tick(Request.CLEAR) == SupervisorState.DISARMED


def test_estop_brakes_at_least_2_s_then_is_silent_until_reset():
    car = Car().running()
    assert car.tick(Request.ESTOP | Request.START) == SupervisorState.ESTOP
    assert (car.action.motor, car.action.steering) == (MotorOutput.ESTOP_BRAKE, SteeringOutput.LIVE)
    car.facts &= ~(Fact.SLOWING | Fact.ESTIMATED)
    car.tick()
    assert (car.action.motor, car.action.steering) == (MotorOutput.DUTY_ZERO, SteeringOutput.HOLD)
    car.facts = GOOD
    car.speed = 0.0
    assert car.tick(Request.RESET) == SupervisorState.ESTOP
    car.ticks(30)
    assert car.action.steering == SteeringOutput.CENTRE
    car.ticks(167)
    assert car.action.motor == MotorOutput.ESTOP_BRAKE
    car.tick()
    assert (car.action.motor, car.action.steering) == (MotorOutput.SILENT, SteeringOutput.NONE)
    assert car.tick(Request.CLEAR | Request.ARM | Request.START) == SupervisorState.ESTOP
    car.facts |= Fact.KILLED
    assert car.tick(Request.RESET) == SupervisorState.ESTOP
    car.facts = GOOD | Fact.HARD
    assert car.tick(Request.RESET) == SupervisorState.ESTOP
    car.facts = GOOD
    assert car.tick(Request.RESET) == SupervisorState.DISARMED


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
    assert car.ticks(100) == SupervisorState.STOPPING


def test_two_ticks_at_one_instant_forget_nothing():
    car = Car()
    car.until(SupervisorState.DISARMED)
    car.ticks(50)
    car.tick(dt=0)
    assert car.ticks(50) == SupervisorState.DISARMED
    assert car.tick() == SupervisorState.READY
