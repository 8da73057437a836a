"""The speed controller's ramp: a VESC follows a new speed no faster than its setpoint may move.

Since firmware 5.03 the setpoint of `SET_RPM` moves by at most 25000 ERPM/s (`s_pid_ramp_erpms_s`,
5.4 m/s^2 on an F1TENTH car). A loop's limit of 2.5 m/s^2 comes in steps of 25 mm/s, and each takes
the setpoint half of the 10 ms until the next: ignored, that is 2 ms of speed lag, and residuals
that are correlated over half a second. The setting is in no log; whether a drive had the firmware's
own is found by likelihood.
"""

# Why: docs/decisions/identification.md#d38

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.dataset import Run, Signal
from steerd.sysid.estimation.log_timing import losses
from steerd.sysid.inference.plain_car import Asked, Rough

Array = NDArray[np.float64]


def _setpoint(command: Signal, rate: float, end: float) -> Signal:
    """Corners of the setpoint's course: straight in between, moving by `rate` at most."""
    now = float(command.values[0])
    times, values = [float(command.t[0])], [now]
    until = np.append(command.t[1:], max(end, command.t[-1]) + 1.0)
    for t, wanted, later in zip(
        command.t.tolist(), command.values.tolist(), until.tolist(), strict=True
    ):
        away = wanted - now
        there = t + abs(away) / rate
        if away and there < later:
            times.append(there)
            values.append(wanted)
        now = wanted if there <= later else now + np.copysign(rate * (later - t), away)
        times.append(later)
        values.append(now)
    return Signal(np.array(times), np.array(values))


def _means(corners: Signal, edges: Array) -> Array:
    """Mean of a signal that is straight between its corners over each interval (exact)."""
    t = np.union1d(corners.t, edges)
    values = np.interp(t, *corners)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    means: Array = np.diff(np.interp(edges, t, area)) / np.diff(edges)
    return means


def ramped(run: Run) -> Run:
    """The drive with its speed commands as the ramp lets them through; without one, as it is."""
    if not run.speed_ramp or not len(run.speed_command.t) or run.speed_source != "command":
        return run
    edges: Array = np.arange(len(run.commands) + 1).astype(float) * run.h
    speed = _means(_setpoint(run.speed_command, run.speed_ramp, float(edges[-1])), edges)
    return replace(run, commands=np.column_stack([run.commands[:, 0], speed]))


class Ramp(NamedTuple):
    """Whether a drive's motor controller had its ramp.

    Attributes:
        run: the drive's name.
        rate: limit of its setpoint [m/s^2]; 0 where the drive knows none.
        sure: by how much the other answer's log-likelihood is smaller.
    """

    run: str
    rate: float
    sure: float


def settle_ramp(
    runs: Sequence[Run], rough: Rough, asked: Asked
) -> tuple[tuple[Run, ...], tuple[Ramp, ...]]:
    """Every drive's speed commands as its motor controller let them through, if that is likelier.

    Args:
        runs: whole drives, not parts of them.
        rough: a car near the truth.
        asked: what is free beside the ramp.

    Raises:
        DataError: a drive does not move.
    """
    settled, found = [], []
    for run in runs:
        after = ramped(run)
        if after is run:
            settled.append(run)
            continue
        plain, limited = losses(run, (run, after), rough, asked)
        better = limited < plain
        settled.append(after if better else run)
        rate = run.speed_ramp if better else 0.0
        found.append(Ramp(run.name, rate, float(abs(plain - limited))))
    return tuple(settled), tuple(found)
