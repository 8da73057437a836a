"""The log jitter of two timers is found in a drive and corrected; other logs stay as they are."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.data.jitter_correction import correct_log_jitter, find_log_jitter, log_period

Array = NDArray[np.float64]

SECONDS, SPEED, LENGTH, LAG = 60.0, 1.5, 0.3, 0.06


def _drive(wait: float, drift: float, seed: int = 3) -> tuple[Run, Array, Array]:
    """A car that steers at 10 Hz, logged late by a sawtooth; with the times sent and logged.

    Args:
        wait: delay of the first command in the recorder [s].
        drift: how fast the delay grows [s/s].
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


def test_a_drifting_delay_is_found_and_corrected() -> None:
    run, left, logged = _drive(0.03, 0.002)
    jitter = find_log_jitter(run)
    assert jitter is not None
    assert jitter.period == pytest.approx(0.1, abs=2e-3)
    true = (logged - left)[1:-1]
    found = jitter.delay(logged[1:-1] - logged[0])
    off = (found - true + 0.05) % 0.1 - 0.05
    off -= np.median(off)  # a common delay is a dead time: the fit finds it
    assert np.sqrt(np.mean(off**2)) < 0.012
    assert jitter.describe()[0] == "drive: steering stored 0 to 100 ms late"
    corrected = correct_log_jitter(run)
    assert corrected.log_jitter == jitter
    assert len(corrected.commands) == len(run.commands)


def test_a_constant_delay_is_not_jitter() -> None:
    run, _, _ = _drive(0.04, 0.0)
    assert find_log_jitter(run) is None
    assert correct_log_jitter(run) is run


def test_the_log_of_a_fast_loop_has_no_period() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    assert log_period(Signal(t, np.sin(t))) == 0.0


def test_constant_steering_has_no_period() -> None:
    assert log_period(Signal(np.arange(0.0, 10.0, 0.1), np.full(100, 0.3))) == 0.0


def test_a_servo_signal_has_no_log_jitter() -> None:
    run, _, _ = _drive(0.03, 0.002)
    pulsed = replace(run, servo_frame=0.02)
    assert correct_log_jitter(pulsed) is pulsed
