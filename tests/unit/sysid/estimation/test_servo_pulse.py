"""Commands that a servo's pulses never take over, and the phase of those pulses."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.dataset import Run, Signal
from steerd.sysid.estimation.command_timing import latch
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.inference.plain_car import TYRES

FRAME = 0.02


def _commanded(steer):
    """A drive whose steering is commanded at 100 Hz, nothing else in it."""
    t = 0.01 * np.arange(len(steer))
    commands = np.column_stack([np.repeat(steer, 2), np.ones(2 * len(steer))])
    bare = Signal(np.empty(0), np.empty((0, 3)))
    return Run("r", 0.005, commands, bare, steer=Signal(t, steer), servo_frame=FRAME)


@pytest.mark.parametrize(("phase", "seen"), [(0.005, 0), (0.015, 1)])
def test_every_second_command_is_never_seen(phase, seen):
    steer = np.random.default_rng(0).uniform(-0.3, 0.3, 40)
    got = latch(_commanded(steer), phase).commands[:, 0]
    late = round((phase - FRAME / 2) / 0.005)
    wanted = np.repeat(steer[seen::2], 4)
    np.testing.assert_allclose(got[late + 20 : 60], wanted[20 : 60 - late][: 40 - late], atol=1e-12)
    assert set(np.round(got[4:-4], 12)) <= set(np.round(steer[seen::2], 12))


def test_a_ramp_keeps_its_mean_time():
    ramp = 0.001 * np.arange(200)
    run = _commanded(ramp)
    middle = slice(40, 360)
    early = [latch(run, p).commands[middle, 0] - run.commands[middle, 0] for p in (0.005, 0.015)]
    for off in early:
        assert np.mean(off) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("phase", [0.005, 0.015])
def test_the_phase_is_found_and_the_car_behind_it(make_drive, simulated, phase):
    truth = DEFAULT_CAR._replace(c_sf=4.4, c_sr=5.9, inertia_z=0.05, steer_delay=0.018)
    plan = make_drive(Model(DEFAULT_CAR), 24.0, 3)
    steer = Signal(plan.h * np.arange(0, len(plan.commands), 2), plan.commands[::2, 0])
    asked = replace(plan, steer=steer, servo_frame=FRAME)
    driven = latch(asked, phase).commands
    first = np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    seen = simulated(Model(truth), driven, first, 3)
    held = np.column_stack([np.repeat(steer.values, 2)[: len(driven)], driven[:, 1]])
    run = replace(seen, commands=held, steer=steer, servo_frame=FRAME)
    free = (*TYRES, "inertia_z", "steer_delay")
    task = Task((run,), Model(DEFAULT_CAR), free=free)
    outcome = learn(task, lambda: 0.0)
    (pulse,) = outcome.pulses
    assert abs(pulse.phase - phase) < 0.004
    assert pulse.sure > 20.0
    for name in free:
        estimate = outcome.fit.estimates[name]
        late = pulse.phase - phase if name == "steer_delay" else 0.0
        assert abs(estimate.value + late - getattr(truth, name)) < 4.0 * estimate.sd + 1e-4, name
    plain = learn(replace(task, runs=(replace(run, servo_frame=0.0),)), lambda: 0.0)
    assert plain.pulses == ()
