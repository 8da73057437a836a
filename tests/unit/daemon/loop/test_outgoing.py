"""Outgoing messages: what was written, why the state changed, how bad it is."""

from dataclasses import replace
from math import inf, isnan, nan
from unittest.mock import Mock

import pytest

from steerd.car_model.state import Command
from steerd.controller.limits import Limits, Verdict, make_limiter_state
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.requests import read_diagnostics
from steerd.daemon.loop import findings as fs
from steerd.daemon.loop import outgoing as out
from steerd.daemon.loop.outgoing import Order, TickResult, make_order
from steerd.daemon.loop.supervisor import Action, make_supervisor_memory
from steerd.daemon.loop.transitions import MotorOutput, SteeringOutput, SupervisorState
from steerd.daemon.settings.config import BrakeSettings
from steerd.steer_bus.messages import BODY, ActuationMode, make_header
from steerd.steer_bus.quick_values import changed
from steerd.vesc_link.scaling import F1TENTH
from steerd.vesc_link.vesc import Drive

MEMORY = make_supervisor_memory(0)


def tick(memory=MEMORY, old=SupervisorState.RUNNING, findings=()):
    """A tick without an estimate."""
    order = Order(Drive(), None, None, Verdict.PASSED)
    return TickResult(order, old, memory, None, None, tuple(findings), "what", 5)


@pytest.mark.parametrize(("drive", "mode", "speed", "current"), [
    (Drive(ActuationMode.SPEED, 0.1, 2.0), ActuationMode.SPEED, 2.0, None),
    (Drive(ActuationMode.BRAKE, 0.1, current=20.0), ActuationMode.BRAKE, None, 20.0),
    (Drive(ActuationMode.SHORT, 0.1), ActuationMode.SHORT, None, None),
    (Drive(ActuationMode.RELEASE, 0.1), ActuationMode.RELEASE, None, None),
    (Drive(steer=0.1), ActuationMode.SILENT, None, None),
])  # fmt: skip
def test_an_actuation_holds_what_its_drive_has_and_nan_elsewhere(drive, mode, speed, current):
    made = out.make_actuation(make_header(5, BODY), drive, b"\x02", 7)
    assert (made.mode, made.steer, made.seq, made.wire) == (mode, 0.1, 7, b"\x02")
    for value, expected in ((made.speed, speed), (made.brake_current_a, current)):
        assert isnan(value) if expected is None else value == expected
    assert out.read_actuation(made)[:2] == (mode, 0.1)


def test_a_state_without_estimate_is_nan_and_a_transition_names_both_states_and_the_reason():
    made = out.make_state(tick(changed(MEMORY, state=SupervisorState.READY)), 3, 10, 100)
    assert (made.mode, made.flags, made.seq, made.mono_ns) == (SupervisorState.READY, 5, 3, 10)
    assert all(isnan(value) for value in (made.x, made.speed, made.e1, made.x_sd))
    memory = changed(MEMORY, state=SupervisorState.ESTOP, reason="W10 pressed")
    made = out.make_transition(tick(memory), 9)
    assert (made.from_state, made.to_state) == (SupervisorState.RUNNING, SupervisorState.ESTOP)
    assert (made.code, made.text) == ("running_estop", "W10 pressed")


@pytest.mark.parametrize(("state", "warned", "level"), [
    (SupervisorState.RUNNING, False, 0), (SupervisorState.RUNNING, True, 1),
    (SupervisorState.FAULT_STOP, True, 2), (SupervisorState.FAULT_LATCHED, False, 2),
    (SupervisorState.ESTOP, False, 2),
])  # fmt: skip
def test_diagnostics_have_a_level_and_the_supervisors_values(state, warned, level):
    memory = changed(MEMORY, state=state, reason="why")
    findings = [fs.make_finding("W7", "60 ms", fs.Severity.WARN)] if warned else []
    made = out.make_diagnostics(tick(memory, findings=findings), "a start", {"uuid": "ab"}, 9)
    assert made.status[0].level == level
    values = read_diagnostics(made)
    assert (values["state"], values["reason"], values["waiting"]) == (state.name, "why", "a start")
    assert values["warnings"] == (findings[0].text if warned else "")
    other = replace(made.status[0], name="lidar")
    with pytest.raises(SteerdError):
        read_diagnostics(replace(made, status=(other,)))


# Orders: each motor output with its current, the limiter on every angle, a missing wish brakes.
BRAKES = BrakeSettings()
LIMITS = Limits(wheelbase=0.33)
SETTINGS = Mock(limits=LIMITS, brakes=BRAKES, scaling=F1TENTH)
T0, TICK = 10**9, 10_000_000


def same(drive, other):
    """Equal, and without a number where the other is without."""
    return str(drive) == str(other)


def order(motor, steering=SteeringOutput.LIVE, wish=None, speed=1.0, cap=inf, steer=0.1):
    state = make_limiter_state(LIMITS, Command(steer, 1.0), T0)
    action = Action(motor, steering, cap)
    return make_order(SETTINGS, state, action, wish, speed, T0 + TICK)


@pytest.mark.parametrize(("motor", "drive"), [
    *((MotorOutput[name], Drive(
        ActuationMode.BRAKE, 0.1, current=getattr(BRAKES, f"{name.lower()}_current_a")))
      for name in ("SOFT_BRAKE", "HOLD_BRAKE", "BRAKE", "ESTOP_BRAKE")),
    (MotorOutput.DUTY_ZERO, Drive(ActuationMode.SHORT, 0.1)),
    (MotorOutput.RELEASE_ONCE, Drive(ActuationMode.RELEASE, 0.1)),
    (MotorOutput.SILENT, Drive(steer=0.1)),
])  # fmt: skip
def test_each_stop_has_its_drive_and_commands_no_speed(motor, drive):
    made = order(motor, SteeringOutput.HOLD, Command(0.3, 3.0))
    assert same(made.drive, drive)
    assert made.command is None
    assert made.limiter.order.speed == 1.0


def test_a_driven_order_is_limited_in_rate_and_under_the_cap():
    made = order(MotorOutput.DRIVE, wish=Command(-0.3, 3.0))
    assert made.drive.mode is ActuationMode.SPEED
    assert made.verdict is Verdict.CLIPPED
    assert made.drive.steer == pytest.approx(0.1 - LIMITS.steer_rate_max * 0.01, abs=1e-3)
    assert made.drive.speed == pytest.approx(1.0 + LIMITS.accel_max * 0.01, abs=1e-3)
    capped = order(MotorOutput.RAMP_STOP, wish=Command(0.1, 3.0), cap=0.99)
    assert capped.drive.speed == pytest.approx(0.99, abs=1e-3)
    assert capped.command == Command(capped.drive.steer, capped.drive.speed)


@pytest.mark.parametrize(("wish", "verdict"), [
    (None, Verdict.PASSED), (Command(nan, 1.0), Verdict.NOT_FINITE),
    (Command(0.0, inf), Verdict.NOT_FINITE),
])  # fmt: skip
def test_without_a_finite_wish_a_driven_car_brakes(wish, verdict):
    made = order(MotorOutput.DRIVE, wish=wish)
    assert same(made.drive, Drive(ActuationMode.BRAKE, current=BRAKES.brake_current_a))
    assert (made.verdict, made.command) == (verdict, None)


@pytest.mark.parametrize(("steering", "steer"), [
    (SteeringOutput.NONE, None), (SteeringOutput.HOLD, 0.1),
    (SteeringOutput.CENTRE, pytest.approx(0.1 - 0.01 * LIMITS.steer_rate_max)),
    (SteeringOutput.LIVE, pytest.approx(0.1 + 0.01 * LIMITS.steer_rate_max)),
])  # fmt: skip
def test_the_angle_of_a_stop_follows_the_steering_output(steering, steer):
    assert order(MotorOutput.BRAKE, steering, Command(0.3, 0.0)).drive.steer == steer


def test_an_unknown_speed_counts_as_the_highest():
    made = order(MotorOutput.BRAKE, SteeringOutput.HOLD, speed=nan, steer=0.3)
    assert made.drive.steer < 0.3, "the lateral acceleration at full speed allows less"
    assert made.limiter.order.speed == LIMITS.speed_max


# Flags of the runner as findings of its watchdogs.
Flag = fs.Flag
NAMES = {
    Flag.SERIAL_FAULT: "W8", Flag.GUARDIAN_LOST: "W16", Flag.GUARDIAN_TRIPPED: "W15",
    Flag.RECORDER_LOST: "W26", Flag.GATEWAY_LOST: "W27", Flag.EXCEPTION: "W29",
    Flag.SUSPENDED: "W28", Flag.REBOOTED: "W12",
}  # fmt: skip


BITS = [value for name, value in vars(Flag).items() if name.isupper()]


def test_every_flag_is_one_bit_of_its_own():
    assert sorted(BITS) == [1 << k for k in range(len(BITS))]


@pytest.mark.parametrize("flag", BITS)
@pytest.mark.parametrize("linked", [0, Flag.LINKED])
def test_each_flag_reports_its_watchdog_or_none(flag, linked):
    found = list(fs.make_reported_findings(flag | linked))
    assert [finding.id for finding in found] == ([NAMES[flag]] if flag in NAMES else [])
    assert all(finding.severity == fs.WATCHDOGS[finding.id].severity for finding in found)
