"""The beat of two timers is found in a drive and undone; a log without one stays as it is."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.data.log_jitter import find_beat, log_period, steadied

Array = NDArray[np.float64]

SECONDS, SPEED, LENGTH, LAG = 60.0, 1.5, 0.3, 0.06


def _drive(wait: float, drift: float, seed: int = 3) -> tuple[Run, Array, Array]:
    """A car that steers at 10 Hz, logged late by a saw; with it when commands left and were logged.

    Args:
        wait: of the first command in the recorder [s].
        drift: how fast waits grow [s/s].
        seed: of steering and noise.
    """
    rng = np.random.default_rng(seed)
    left = 0.1 * np.arange(SECONDS / 0.1)
    steps = np.repeat(rng.uniform(-0.3, 0.3, 200), rng.integers(1, 9, 200))[: len(left)]
    t = np.arange(0.0, SECONDS, 0.002)
    held = steps[np.minimum((t / 0.1).astype(int), len(steps) - 1)]
    angle, angles = 0.0, np.empty_like(held)
    for i, command in enumerate(held.tolist()):
        angle += (1.0 - np.exp(-0.002 / LAG)) * (command - angle)
        angles[i] = angle
    yaw = np.cumsum(SPEED * np.tan(angles) / LENGTH) * 0.002
    place = np.cumsum(SPEED * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0) * 0.002
    poses = np.column_stack([place, yaw])[::5] + rng.normal(0.0, 5e-4, (len(t[::5]), 3))
    logged = left + np.mod(wait + drift * left, 0.1)
    return (
        make_run("drive", Signal(logged, steps), None, Signal(t[::5], poses)), left, logged,
    )  # fmt: skip


def test_a_drifting_wait_is_found_and_undone() -> None:
    run, left, logged = _drive(0.03, 0.002)
    beat = find_beat(run)
    assert beat is not None
    assert beat.period == pytest.approx(0.1, abs=2e-3)
    true = (logged - left)[1:-1]
    told = beat.wait(logged[1:-1] - logged[0])
    off = (told - true + 0.05) % 0.1 - 0.05
    off -= np.median(off)  # a wait that all share is a dead time: the fit finds it
    assert np.sqrt(np.mean(off**2)) < 0.012
    assert beat.describe()[0] == "drive: steering stored 0 to 100 ms late"
    undone = steadied(run)
    assert undone.beat == beat
    assert len(undone.commands) == len(run.commands)


def test_a_constant_wait_is_no_beat() -> None:
    run, _, _ = _drive(0.04, 0.0)
    assert find_beat(run) is None
    assert steadied(run) is run


def test_the_log_of_a_fast_loop_has_no_period() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    assert log_period(Signal(t, np.sin(t))) == 0.0


def test_constant_steering_has_no_period() -> None:
    assert log_period(Signal(np.arange(0.0, 10.0, 0.1), np.full(100, 0.3))) == 0.0


def test_pulses_of_a_servo_leave_no_beat_to_look_for() -> None:
    run, _, _ = _drive(0.03, 0.002)
    pulsed = replace(run, servo_frame=0.02)
    assert steadied(pulsed) is pulsed
