"""Outgoing messages: what was written, why the state changed, how bad it is."""

from math import isnan

import pytest

from steerd.daemon.ipc.diagnostics import read_diagnostics
from steerd.daemon.loop.findings import Severity, make_finding
from steerd.daemon.loop.outgoing import (
    make_actuation,
    make_diagnostics,
    make_state,
    make_transition,
    read_actuation,
)
from steerd.daemon.loop.supervisor import Action, make_supervisor_memory
from steerd.daemon.loop.transitions import MotorOutput, SteeringOutput, SupervisorState
from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.quick_values import changed
from steerd.vesc_link.vesc import Drive

ACTION = Action(MotorOutput.SILENT, SteeringOutput.NONE, 0.0, "why", "what")


@pytest.mark.parametrize(
    ("drive", "mode", "speed", "current"),
    [
        (Drive(ActuationMode.SPEED, 0.1, 2.0), ActuationMode.SPEED, 2.0, None),
        (Drive(ActuationMode.BRAKE, 0.1, current=20.0), ActuationMode.BRAKE, None, 20.0),
        (Drive(ActuationMode.SHORT, 0.1), ActuationMode.SHORT, None, None),
        (Drive(ActuationMode.RELEASE, 0.1), ActuationMode.RELEASE, None, None),
        (Drive(steer=0.1), ActuationMode.SILENT, None, None),
    ],
)
def test_an_actuation_holds_what_its_drive_has_and_nan_elsewhere(drive, mode, speed, current):
    made = make_actuation(drive, b"\x02", 7, 5)
    assert (made.mode, made.steer, made.seq, made.wire) == (mode, 0.1, 7, b"\x02")
    for value, expected in ((made.speed, speed), (made.brake_current_a, current)):
        assert isnan(value) if expected is None else value == expected
    assert read_actuation(made)[:2] == (mode, 0.1)


def test_a_state_without_estimate_is_nan_and_has_mode_and_flags():
    made = make_state(None, None, Drive(), SupervisorState.READY, 5, 3, 10, 100)
    assert (made.mode, made.flags, made.seq, made.mono_ns) == (SupervisorState.READY, 5, 3, 10)
    assert all(isnan(value) for value in (made.x, made.speed, made.e1, made.x_sd))


def test_a_transition_names_both_states_and_the_reason():
    memory = changed(make_supervisor_memory(0), state=SupervisorState.ESTOP, reason="W10 pressed")
    made = make_transition(SupervisorState.RUNNING, memory, 9)
    assert (made.from_state, made.to_state) == (SupervisorState.RUNNING, SupervisorState.ESTOP)
    assert (made.code, made.text) == ("running_estop", "W10 pressed")


@pytest.mark.parametrize(
    ("state", "warned", "level"),
    [
        (SupervisorState.RUNNING, False, 0),
        (SupervisorState.RUNNING, True, 1),
        (SupervisorState.FAULT_STOP, True, 2),
        (SupervisorState.FAULT_LATCHED, False, 2),
        (SupervisorState.ESTOP, False, 2),
    ],
)
def test_diagnostics_have_a_level_and_the_supervisors_values(state, warned, level):
    memory = changed(make_supervisor_memory(0), state=state)
    findings = [make_finding("W7", "60 ms", Severity.WARN)] if warned else []
    made = make_diagnostics(memory, ACTION, "a start", findings, {"uuid": "ab"}, 9)
    assert made.status[0].level == level
    values = read_diagnostics(made)
    assert (values["state"], values["reason"], values["waiting"]) == (state.name, "why", "a start")
    assert values["warnings"] == (findings[0].text if warned else "")
