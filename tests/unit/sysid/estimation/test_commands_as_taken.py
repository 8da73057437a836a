"""Commands as actuators take them over: the phase of servo pulses, the ramp of the motor."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.dataset import RAMP_ERPM, Run, Signal
from steerd.sysid.estimation.command_timing import latch, ramped
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.paper import NAMES as TYRES

FRAME = 0.02
FIRST = np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0])  # the state at a drive's begin


def _commanded(steer, speed=None, **more):
    """A drive that is commanded at 100 Hz, nothing else in it."""
    t, speed = 0.01 * np.arange(len(steer)), np.ones(len(steer)) if speed is None else speed
    commands = np.repeat(np.column_stack([steer, speed]), 2, axis=0)
    bare, asked = Signal(np.empty(0), np.empty((0, 3))), Signal(t, speed)
    more = {"servo_frame": FRAME, **more}
    return Run("r", 0.005, commands, bare, steer=Signal(t, steer), speed_command=asked, **more)


@pytest.mark.parametrize(("phase", "seen"), [(0.005, 0), (0.015, 1)])
def test_every_second_command_is_never_seen(phase, seen):
    steer = np.random.default_rng(0).uniform(-0.3, 0.3, 40)
    got = latch(_commanded(steer), phase).commands[:, 0]
    late = round((phase - FRAME / 2) / 0.005)
    wanted = np.repeat(steer[seen::2], 4)
    np.testing.assert_allclose(got[late + 20 : 60], wanted[20 : 60 - late][: 40 - late], atol=1e-12)
    assert set(np.round(got[4:-4], 12)) <= set(np.round(steer[seen::2], 12))


@pytest.mark.parametrize("phase", [0.005, 0.015])
def test_the_phase_is_found_and_the_car_behind_it(make_drive, simulated, phase):
    truth = DEFAULT_CAR._replace(c_sf=4.4, c_sr=5.9, inertia_z=0.05, steer_delay=0.018)
    plan = make_drive(Model(DEFAULT_CAR), 24.0, 3)
    steer = Signal(plan.h * np.arange(0, len(plan.commands), 2), plan.commands[::2, 0])
    asked = replace(plan, steer=steer, servo_frame=FRAME)
    driven = latch(asked, phase).commands
    seen = simulated(Model(truth), driven, FIRST, 3)
    held = np.column_stack([np.repeat(steer.values, 2)[: len(driven)], driven[:, 1]])
    run = replace(seen, commands=held, steer=steer, servo_frame=FRAME)
    free = (*TYRES, "inertia_z", "steer_delay")
    outcome = learn(Task((run,), Model(DEFAULT_CAR), free=free), lambda: 0.0)
    (pulse,) = outcome.pulses
    assert abs(pulse.phase - phase) < 0.004
    assert pulse.sure > 15.0
    for name in free:
        estimate = outcome.fit.estimates[name]
        late = pulse.phase - phase if name == "steer_delay" else 0.0
        assert abs(estimate.value + late - getattr(truth, name)) < 4.0 * estimate.sd + 1e-4, name


# The motor controller's ramp: its course, and whether a drive had one.
RATE = RAMP_ERPM / 4614.0


def _asked(speed, rate):
    return _commanded(np.zeros(len(speed)), speed, speed_ramp=rate)


def test_speeds_without_ramp_or_command_stay():
    run = _asked(np.linspace(1.0, 2.0, 30), 0.0)
    assert ramped(run) is run
    measured = replace(run, speed_ramp=RATE, speed_source="wheel")
    assert ramped(measured) is measured


@pytest.mark.parametrize("rate", [0.4, 2.0, 50.0])
def test_the_setpoint_matches_a_fine_simulation(rate):
    speed = np.cumsum(np.random.default_rng(2).uniform(-0.05, 0.05, 60)) + 1.0
    speed[30:] += 0.3
    run = _asked(speed, rate)
    fine, now, course = 1e-5, float(speed[0]), []
    for wanted in speed:
        for _ in range(1000):
            course.append(now)
            now += float(np.clip(wanted - now, -rate * fine, rate * fine))
    means = np.array(course).reshape(-1, 500).mean(axis=1)
    np.testing.assert_allclose(ramped(run).commands[:, 1], means, atol=2e-5 * rate + 1e-9)
    for other in (replace(run, speed_ramp=0.0), replace(run, speed_source="wheel")):
        assert ramped(other) is other, "without ramp or speed command"


@pytest.mark.parametrize("had", [True, False])
def test_it_is_told_whether_a_drive_had_the_ramp(make_drive, simulated, had):
    plan = make_drive(Model(DEFAULT_CAR), 24.0, 5)
    speed = plan.commands[:, 1].copy()
    for k in range(1, len(speed)):
        speed[k] = speed[k - 1] + np.clip(speed[k] - speed[k - 1], -0.0125, 0.0125)
    asked = Signal(0.01 * np.arange(len(speed) // 2), speed[::2])
    steer = plan.commands[: 2 * len(asked.t), 0]
    held = np.column_stack([steer, np.repeat(asked.values, 2)])
    sent = replace(plan, commands=held, speed_command=asked, speed_ramp=RATE, servo_frame=0.0)
    driven = ramped(sent).commands if had else sent.commands
    seen = simulated(Model(DEFAULT_CAR), driven, FIRST, 5)
    run = replace(seen, commands=sent.commands, speed_command=asked, speed_ramp=RATE)
    free = ("lf", "lr", "c_sf", "c_sr", "speed_lag")
    outcome = learn(Task((run,), Model(DEFAULT_CAR), free=free), lambda: 0.0)
    (ramp,) = outcome.ramps
    assert ramp.rate == (RATE if had else 0.0)
    assert ramp.sure > 10.0
    lag = outcome.fit.estimates["speed_lag"]
    assert abs(lag.value - DEFAULT_CAR.speed_lag) < 4.0 * lag.sd
