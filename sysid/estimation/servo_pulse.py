"""The servo's pulse: commands that a VESC's 50 Hz servo signal takes over, and those it never sees.

A servo signal carries one angle per frame of 20 ms. Of the commands of a 100 Hz loop every second
one is never seen; which one depends on the phase of the pulses, which no log knows. Here a drive's
steering is sampled as the pulses do, at the phase that explains its poses best.

The sampled signal is put half a frame early, so that a fitted `steer_delay` goes on meaning what
controllers and filters, which know no frames, take it for: the dead time with the mean wait for a
pulse (half a frame) included.
"""

# Why: docs/decisions/identification.md#d24

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run, Signal, hold_means
from steerd.sysid.estimation.log_timing import losses
from steerd.sysid.inference.plain_car import Asked, Rough

Array = NDArray[np.float64]

PHASES = 8
"""Phases that are tried, evenly over a frame (2.5 ms apart)."""
SURE = 3.0
"""A log-likelihood smaller by less than this does not distinguish two phases."""


class Pulse(NamedTuple):
    """How a drive's servo was pulsed.

    Attributes:
        run: the drive's name.
        phase: of the pulses after the drive's first command [s].
        sure: by how much the log-likelihood falls at the best phase that does not look alike.
        blur: by how much it may be off: phases between the same two commands look alike, but for a
            dead time (standard deviation) [s].
    """

    run: str
    phase: float
    sure: float
    blur: float = 0.0


def latch(run: Run, phase: float) -> Run:
    """The drive with its steering as pulses at `phase` take it over, half a frame early."""
    frame = run.servo_frame
    t, angles = run.steer
    first = np.floor((t[0] - phase) / frame)
    pulses = phase + frame * np.arange(first, np.ceil((run.duration - phase) / frame) + 2)
    seen = angles[np.maximum(np.searchsorted(t, pulses, side="right") - 1, 0)]
    edges: Array = np.arange(len(run.commands) + 1).astype(float) * run.h
    steer = hold_means(Signal(pulses - 0.5 * frame, seen), edges)
    return replace(run, commands=np.column_stack([steer, run.commands[:, 1]]))


def settle_servo(
    runs: Sequence[Run], rough: Rough, asked: Asked
) -> tuple[tuple[Run, ...], tuple[Pulse, ...]]:
    """Sample every pulsed drive's steering at its likeliest phase; other drives stay.

    Args:
        runs: whole drives, not parts of them.
        rough: a car near the truth.
        asked: what is free beside the phase.

    Raises:
        DataError: a drive does not move.
    """
    pulses = {id(run): find_phase(run, rough, asked) for run in runs if run.servo_frame}
    settled = (latch(run, pulses[id(run)].phase) if id(run) in pulses else run for run in runs)
    return tuple(settled), tuple(pulses.values())


def find_phase(run: Run, rough: Rough, asked: Asked) -> Pulse:
    """The likeliest phase of a drive's pulses, all free parameters adapted to each."""
    step = run.servo_frame / PHASES
    phases = step * (np.arange(PHASES) + 0.5)
    tried = losses(run, [latch(run, float(phase)) for phase in phases], rough, asked)
    best, alike = _middle(tried)
    others = tried[~alike]
    sure = float(others.min() - tried.min()) if len(others) else 0.0
    phase = _on_grid(float(phases[0] + best * step), run.h, step)
    possible = int((tried <= tried.min() + SURE).sum())
    return Pulse(run.name, phase, sure, float(step * possible / np.sqrt(12.0)))


def _on_grid(phase: float, h: float, step: float) -> float:
    """The nearest phase whose pulses fall between steps of the grid, if it is as good as this one.

    A pulse within a step would be blurred over it, and 2 ms of blur pass for inertia.
    """
    near = h * round(phase / h)
    return near if abs(near - phase) <= 0.5 * step + 1e-9 else phase


def _middle(losses: Array) -> tuple[float, NDArray[np.bool_]]:
    """Middle of the stretch of phases (they form a ring) about the best that are as good."""
    count, best = len(losses), int(np.argmin(losses))
    good = losses <= losses[best] + SURE
    up = next((i for i in range(count) if not good[(best + i + 1) % count]), count - 1)
    down = next((i for i in range(count) if not good[(best - i - 1) % count]), count - 1)
    alike = np.zeros(count, bool)
    alike[np.arange(best - down, best + up + 1) % count] = True
    return (best + 0.5 * (up - down)) % count, alike
