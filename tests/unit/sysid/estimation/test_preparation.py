"""Start values that do not stand in the way: inertia, loads and end stops of another car."""

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.dataset import Signal, make_run
from steerd.sysid.estimation.preparation import (
    exceeds_slew_rate,
    largest_steering,
    level_loads,
    restore_end_stops,
    scale_inertia,
    widen_end_stops,
)
from steerd.sysid.estimation.validation import Trace, by_lateral_acceleration

CAR = Model(DEFAULT_CAR)


def _run(steer=0.3, speed=True, servo_frame=0.0):
    t = np.arange(0.0, 8.0, 0.05)
    angles = steer * np.sin(t)
    poses = np.column_stack([t, np.sin(t), 0.2 * np.sin(t)])
    asked = Signal(t, np.ones(len(t))) if speed else None
    return make_run("r", Signal(t, angles), asked, Signal(t, poses), servo_frame=servo_frame)


def test_inertia_follows_mass_and_length_squared():
    half = CAR._replace(
        car=DEFAULT_CAR._replace(
            lf=DEFAULT_CAR.lf / 2, lr=DEFAULT_CAR.lr / 2, mass=DEFAULT_CAR.mass / 2
        )
    )
    assert scale_inertia(half, CAR).car.inertia_z == pytest.approx(DEFAULT_CAR.inertia_z / 8)
    assert scale_inertia(CAR, CAR) == CAR


def test_loads_do_not_follow_a_measured_speed():
    assert level_loads(CAR, [_run(speed=False)]).car.cog_height == 0.0
    assert level_loads(CAR, [_run()]) == CAR


def test_end_stops_of_another_car_do_not_clip_a_log():
    run = _run(steer=0.3)
    wide = widen_end_stops(CAR, [run], ()).car
    assert wide.steer_max == -wide.steer_min == pytest.approx(0.45, abs=1e-3)
    assert widen_end_stops(CAR, [_run(steer=0.1)], ()) == CAR
    assert widen_end_stops(CAR, [run], ("steer_max",)) == CAR
    assert widen_end_stops(CAR, [_run(servo_frame=0.02)], ()) == CAR
    known = restore_end_stops(wide._replace(steer_gain=1.4), CAR.car, [run])
    assert known.steer_max == pytest.approx(1.4 * largest_steering([run]), rel=1e-3)
    assert restore_end_stops(wide, CAR.car, [run]).steer_max == CAR.car.steer_max


def test_errors_are_told_by_lateral_acceleration():
    ahead = np.arange(-0.4, 1.5, 0.05)

    def trace(rate, off):
        yaw = rate * ahead
        measured = np.column_stack([np.sin(yaw) / rate, (1 - np.cos(yaw)) / rate, yaw])
        return Trace(0, ahead, ahead, measured, measured + np.array([off, 0.0, 0.0]))

    slow, fast = by_lateral_acceleration([trace(1.0, 0.01), trace(3.0, 0.2)], 1.0)
    assert (slow.low, slow.high, slow.windows) == (0.0, 2.0, 1)
    assert slow.median == pytest.approx(0.01)
    assert (fast.low, fast.rms) == (2.0, pytest.approx(0.2))
    assert by_lateral_acceleration([], 1.0) == ()


def test_only_steps_that_the_file_s_servo_cannot_follow_outpace_it():
    t = np.arange(0.0, 8.0, 0.01)
    poses = Signal(t, np.column_stack([t, np.sin(t), 0.2 * np.sin(t)]))

    def asked(angles):
        return [make_run("r", Signal(t, angles), Signal(t, np.ones(len(t))), poses)]

    steps = asked(0.2 * np.sign(np.sin(t)))
    ramps = asked(np.clip(3.0 * (np.abs(t % 4.0 - 2.0) - 1.0), -0.3, 0.3))
    assert exceeds_slew_rate(CAR, steps)
    assert not exceeds_slew_rate(CAR, ramps)
    assert not exceeds_slew_rate(CAR._replace(car=DEFAULT_CAR._replace(steer_rate=12.0)), steps)
