"""The motor controller's ramp: its course, and whether a drive had one."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.dataset import RAMP_ERPM, Run, Signal
from steerd.sysid.estimation.command_timing import ramped
from steerd.sysid.estimation.learn import Task, learn

RATE = RAMP_ERPM / 4614.0


def _asked(speed, rate):
    t = 0.01 * np.arange(len(speed))
    commands = np.column_stack([np.zeros(2 * len(speed)), np.repeat(speed, 2)])
    bare = Signal(np.empty(0), np.empty((0, 3)))
    return Run("r", 0.005, commands, bare, speed_command=Signal(t, speed), speed_ramp=rate)


def test_a_step_becomes_a_straight_slope():
    run = _asked(np.concatenate([np.zeros(2), np.full(40, 1.0)]), 5.0)
    got = ramped(run).commands[:, 1]
    middle = 0.005 * (np.arange(len(got)) + 0.5)
    np.testing.assert_allclose(got, np.clip(5.0 * (middle - 0.02), 0.0, 1.0), atol=1e-12)


@pytest.mark.parametrize("rate", [0.4, 2.0, 50.0])
def test_the_setpoint_matches_a_fine_simulation(rate):
    speed = np.cumsum(np.random.default_rng(2).uniform(-0.05, 0.05, 60)) + 1.0
    run = _asked(speed, rate)
    fine, now, course = 1e-5, float(speed[0]), []
    for wanted in speed:
        for _ in range(1000):
            course.append(now)
            now += float(np.clip(wanted - now, -rate * fine, rate * fine))
    means = np.array(course).reshape(-1, 500).mean(axis=1)
    np.testing.assert_allclose(ramped(run).commands[:, 1], means, atol=2e-5 * rate + 1e-9)


def test_without_a_ramp_or_a_speed_command_nothing_changes():
    run = _asked(np.linspace(1.0, 2.0, 30), 0.0)
    assert ramped(run) is run
    measured = replace(run, speed_ramp=RATE, speed_source="wheel")
    assert ramped(measured) is measured


@pytest.mark.parametrize("had", [True, False])
def test_it_is_told_whether_a_drive_had_the_ramp(make_drive, simulated, had):
    plan = make_drive(Model(DEFAULT_CAR), 24.0, 5)
    speed = plan.commands[:, 1].copy()
    for k in range(1, len(speed)):
        speed[k] = speed[k - 1] + np.clip(speed[k] - speed[k - 1], -0.0125, 0.0125)
    speed_command = Signal(0.01 * np.arange(len(speed) // 2), speed[::2])
    held = np.column_stack(
        [plan.commands[: 2 * len(speed_command.t), 0], np.repeat(speed_command.values, 2)]
    )
    sent = replace(
        plan, commands=held, speed_command=speed_command, speed_ramp=RATE, servo_frame=0.0
    )
    driven = ramped(sent).commands if had else sent.commands
    first = np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    seen = simulated(Model(DEFAULT_CAR), driven, first, 5)
    run = replace(seen, commands=sent.commands, speed_command=speed_command, speed_ramp=RATE)
    free = ("lf", "lr", "c_sf", "c_sr", "speed_lag")
    outcome = learn(Task((run,), Model(DEFAULT_CAR), free=free), lambda: 0.0)
    (ramp,) = outcome.ramps
    assert ramp.rate == (RATE if had else 0.0)
    assert ramp.sure > 10.0
    lag = outcome.fit.estimates["speed_lag"]
    assert abs(lag.value - DEFAULT_CAR.speed_lag) < 4.0 * lag.sd
