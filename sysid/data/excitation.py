"""Excitation of a drive: how much steering and speed varied, and what was missing."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run, pose_rates, pose_speed

Array = NDArray[np.float64]

TURNING = 0.03
"""Steering beyond this is a turn [rad]."""
SPEED_SPAN, STEER_RATE, ONE_SIDE, LATERAL = 0.4, 0.2, 0.05, 1.0
"""Below these a session is called poor: [m/s], [rad/s], share of time, [m/s^2]."""

TRACKING_ERROR, TRACKING_SHARE = 0.2, 0.3
"""A car follows its speed command within these [m/s] plus this share of the command."""


class Excitation(NamedTuple):
    """Excitation of drives.

    Attributes:
        seconds: of driving; distance: [m].
        speed_low, speed_high: 5th and 95th percentile [m/s].
        steer_rms: about its mean [rad].
        steer_rate: RMS of the commanded steering's rate [rad/s].
        left, right: share of time in turns to either side.
        lateral_accel: 99th percentile [m/s^2].
        lacking: what was missing, for the reader.
    """

    seconds: float
    distance: float
    speed_low: float
    speed_high: float
    steer_rms: float
    steer_rate: float
    left: float
    right: float
    lateral_accel: float
    lacking: tuple[str, ...]


def measure_excitation(runs: Sequence[Run]) -> Excitation:
    """Measure the excitation of drives together."""
    steer = np.concatenate([run.commands[:, 0] for run in runs])
    rate = np.concatenate([_smooth_rate(run) for run in runs])
    speed = np.concatenate([pose_speed(run.pose).values for run in runs])
    turn = np.concatenate([_lateral(run) for run in runs])
    low, high = np.percentile(np.abs(speed), [5.0, 95.0])
    left, right = float(np.mean(steer > TURNING)), float(np.mean(steer < -TURNING))
    seconds = sum(float(np.ptp(run.pose.t)) for run in runs)
    lateral = float(np.percentile(turn, 99.0))
    steer_rate = float(np.sqrt(np.mean(rate**2)))
    return Excitation(
        seconds, float(np.abs(speed).mean()) * seconds, float(low), float(high),
        float(np.std(steer)), steer_rate, left, right, lateral,
        tuple(_lacking(float(high - low), steer_rate, min(left, right), lateral)),
    )  # fmt: skip


def speed_tracking_share(runs: Sequence[Run]) -> float:
    """Share of the time in which the cars followed their speed commands.

    1 where no speed was commanded.
    """
    near = [np.empty(0, bool)]
    for run in runs:
        if run.speed_source == "command":
            t, speed = pose_speed(run.pose)
            commanded = run.commands[np.clip((t / run.h).astype(int), 0, len(run.commands) - 1), 1]
            near.append(
                np.abs(speed - commanded) <= TRACKING_ERROR + TRACKING_SHARE * np.abs(commanded)
            )
    every = np.concatenate(near)
    return float(every.mean()) if len(every) else 1.0


def _smooth_rate(run: Run) -> Array:
    steer = run.commands[:, 0]
    return np.diff(steer, prepend=steer[:1]) / run.h


def _lateral(run: Run) -> Array:
    """Lateral acceleration from poses [m/s^2]."""
    rates = pose_rates(run.pose)
    return np.asarray(np.abs(rates.yaw_rate * rates.speed))


def _lacking(speed_span: float, steer_rate: float, less: float, lateral: float) -> list[str]:
    lacking = []
    if speed_span < SPEED_SPAN:
        lacking.append("one speed only: drive bends at two or more speeds")
    if steer_rate < STEER_RATE:
        lacking.append("slow steering: add steps or a chirp")
    if less < ONE_SIDE:
        lacking.append("turns to one side only: drive the other as well")
    if lateral < LATERAL:
        lacking.append("gentle bends only: tyres are not identifiable below 1 m/s²")
    return lacking
