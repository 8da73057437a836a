"""Excitation of a drive: how much steering and speed varied, and what was missing."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from steerd.sysid.data.dataset import Run, pose_rates

TURNING = 0.03  # steering beyond this is a turn [rad]
SPEED_SPAN, STEER_RATE, ONE_SIDE, LATERAL = 0.4, 0.2, 0.05, 1.0
"""Below these a session is called poor: [m/s], [rad/s], share of time, [m/s^2]."""

TRACKING_ERROR, TRACKING_SHARE = 0.2, 0.3
"""A car follows its speed command within these [m/s] plus this share of the command."""


class Excitation(NamedTuple):
    """Excitation of drives."""

    seconds: float  # of driving
    distance: float  # [m]
    speed_low: float  # 5th percentile [m/s]
    speed_high: float  # 95th percentile [m/s]
    steer_rms: float  # about its mean [rad]
    steer_rate: float  # RMS of the commanded steering's rate [rad/s]
    left: float  # share of time in turns to the left; right: to the right
    right: float
    lateral_accel: float  # 99th percentile [m/s^2]
    lacking: tuple[str, ...]  # what was missing, for the reader


def measure_excitation(runs: Sequence[Run]) -> Excitation:
    """Measure the excitation of drives together."""
    steers, rates = [run.commands[:, 0] for run in runs], [pose_rates(run.pose) for run in runs]
    turned = [np.diff(s, prepend=s[:1]) / run.h for s, run in zip(steers, runs, strict=True)]
    steer, rate = np.concatenate(steers), np.concatenate(turned)
    speed = np.abs(np.concatenate([each.speed for each in rates]))
    aside = np.abs(np.concatenate([each.yaw_rate * each.speed for each in rates]))
    low, high = (float(value) for value in np.percentile(speed, [5.0, 95.0]))
    left, right = float(np.mean(steer > TURNING)), float(np.mean(steer < -TURNING))
    seconds = sum(float(np.ptp(run.pose.t)) for run in runs)
    lateral = float(np.percentile(aside, 99.0))
    steer_rate = float(np.sqrt(np.mean(rate**2)))
    poor = {
        "one speed only: drive bends at two or more speeds": high - low < SPEED_SPAN,
        "slow steering: add steps or a chirp": steer_rate < STEER_RATE,
        "turns to one side only: drive the other as well": min(left, right) < ONE_SIDE,
        "gentle bends only: tyres are not identifiable below 1 m/s²": lateral < LATERAL,
    }
    return Excitation(
        seconds, float(speed.mean()) * seconds, low, high, float(np.std(steer)), steer_rate, left,
        right, lateral, tuple(text for text, lacks in poor.items() if lacks),
    )  # fmt: skip


def speed_tracking_share(runs: Sequence[Run]) -> float:
    """Share of the time in which the cars followed their speed commands.

    1 where no speed was commanded.
    """
    near = [np.empty(0, bool)]
    for run in runs:
        if run.speed_source == "command":
            t, speed, _ = pose_rates(run.pose)
            commanded = run.commands[np.clip((t / run.h).astype(int), 0, len(run.commands) - 1), 1]
            near.append(
                np.abs(speed - commanded) <= TRACKING_ERROR + TRACKING_SHARE * np.abs(commanded)
            )
    every = np.concatenate(near)
    return float(every.mean()) if len(every) else 1.0
