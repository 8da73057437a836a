"""Live parameters: what a person may change of the lane keeper while it drives, and how far.

A lower speed, a lane beside the path, more or less feedback. Bounds are computed once, before the
car moves: no value within them drives faster, harder or less damped than the run was checked for.
"""

# Why: docs/decisions/safety.md#d74

import math
from collections.abc import Iterator
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.car_model.path.path import Path, Projection, interpolate
from steerd.controller.config import ControllerConfig
from steerd.controller.design import assessed_speeds, closed_loop, find_faults, stability
from steerd.controller.gain_table import N_TURNING, GainTable, look_up
from steerd.controller.loop_model import Timing

SPEED_LEAST = 0.3  # lowest live speed [m/s]: below it a VESC's speed loop lets the motor go
GAIN_LEAST, GAIN_MOST, GAIN_STEP = 0.5, 1.5, 0.1  # shares of the designed feedback that are checked
OFFSET_STEP = 0.01  # resolution of the largest offset [m]
OFFSET_RATE, GAIN_RATE = 0.1, 0.5
"""How fast a new offset [m/s] and a new share of the feedback [1/s] come into force."""
SQUEEZE_LEAST = 0.5  # least 1 - curvature offset: a lane closer to a turn's centre has no sense


class LiveValues(NamedTuple):
    """Live parameters."""

    speed: float  # highest speed along the lane [m/s]
    offset: float  # how far the lane is shifted to the left of the path [m]
    gain: float  # share of the designed feedback


AS_DESIGNED = LiveValues(math.inf, 0.0, 1.0)  # nothing is changed


class LiveBounds(NamedTuple):
    """Lowest and highest values, and those of the run's start."""

    low: LiveValues
    high: LiveValues
    start: LiveValues


def make_live_bounds(
    car: Car[float],
    path: Path,
    config: ControllerConfig,
    table: GainTable,
    timing: Timing,
    offset_max: float,
) -> LiveBounds:
    """The bounds of a controller: the settings' speed is the highest.

    The car is that of the design, with the limiter's end stops; the offset is `offset_max` [m] at
    most, whatever the car can turn.
    """
    gain_low, gain_high = find_gain_bounds(car, table, timing, config.damping_min)
    low = LiveValues(
        min(SPEED_LEAST, config.speed), -_find_offset(car, path, table, -offset_max), gain_low
    )
    high = LiveValues(config.speed, _find_offset(car, path, table, offset_max), gain_high)
    return LiveBounds(low, high, LiveValues(config.speed, 0.0, 1.0))


def find_gain_bounds(
    car: Car[float], table: GainTable, timing: Timing, damping_min: float
) -> tuple[float, float]:
    """Lowest and highest share of the feedback around 1 that passes the design's own check.

    Each share is checked at every speed of that check. The outermost that passes is left out
    unless it is the last of the ladder: what is granted has a neighbour that passes too.
    """
    count = round((GAIN_MOST - GAIN_LEAST) / GAIN_STEP) + 1
    shares = [round(GAIN_LEAST + i * GAIN_STEP, 3) for i in range(count)]
    passes = [True] * count
    for speed in assessed_speeds(table):
        row = look_up(table, speed)
        quiet = (0.0,) * (len(row) - N_TURNING) + row[-N_TURNING:]
        free = closed_loop(car, quiet, table.pasts, speed, timing)
        fed = closed_loop(car, row, table.pasts, speed, timing) - free
        for i, share in enumerate(shares):
            if passes[i]:
                at = stability(free + share * fed, speed, timing.period_s)
                passes[i] = not find_faults([at], damping_min)
    middle = shares.index(1.0)
    low = _walk(passes, range(middle, -1, -1))
    high = _walk(passes, range(middle, count))
    return shares[low], shares[high]


def _walk(passes: list[bool], order: range) -> int:
    """The last place of the order to be granted."""
    passed: list[int] = []
    for i in order:
        if not passes[i]:
            return passed[-2] if len(passed) > 1 else order[0]
        passed.append(i)
    return passed[-1]


def _find_offset(car: Car[float], path: Path, table: GainTable, offset_max: float) -> float:
    """The largest |offset| on one side, up to |offset_max|, that the car can follow [m]."""
    wheel = max(row[-N_TURNING] for row in table.rows)
    curvatures = (min(path.curvature), max(path.curvature))
    found = 0.0
    for offset in _steps(offset_max):
        if any(1.0 - k * offset < SQUEEZE_LEAST for k in curvatures):
            break
        if any(
            not car.steer_min <= wheel * shift_curvature(k, offset) <= car.steer_max
            for k in curvatures
        ):
            break
        found = abs(offset)
    return found


def _steps(offset_max: float) -> Iterator[float]:
    count = math.floor(abs(offset_max) / OFFSET_STEP + 1e-9)
    return (math.copysign(i * OFFSET_STEP, offset_max) for i in range(1, count + 1))


def shift_curvature(curvature: float, offset: float) -> float:
    """Curvature [1/m] of the line so far to the left [m] of one with this curvature."""
    return curvature / (1.0 - curvature * offset)


def shift_lane(at: Projection, offset: float) -> Projection:
    """A point's place against the lane so far to the left of the path [m]."""
    if not offset:
        return at
    return at._replace(e1=at.e1 - offset, curvature=shift_curvature(at.curvature, offset))


def limit_target(
    target: float, path: Path, s: float, live: LiveValues, config: ControllerConfig
) -> float:
    """The profile's speed at `s` [m] under live parameters [m/s]: never more than the profile's."""
    bound = min(target, live.speed)
    if live.offset:
        curvature = abs(shift_curvature(interpolate(path, path.curvature, s), live.offset))
        if curvature * bound * bound > config.lateral_accel_max:
            bound = math.sqrt(config.lateral_accel_max / curvature)
    return bound


def approach(now: LiveValues, aim: LiveValues, dt: float) -> LiveValues:
    """Live parameters after `dt` seconds; the speed follows by the ramp of its reference."""
    if now == aim:
        return aim
    return LiveValues(
        aim.speed,
        _step(now.offset, aim.offset, OFFSET_RATE * dt),
        _step(now.gain, aim.gain, GAIN_RATE * dt),
    )


def _step(now: float, aim: float, most: float) -> float:
    return min(max(aim, now - most), now + most)
