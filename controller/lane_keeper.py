"""Steering: lane errors from an estimate and its projection, and the feedback law upon them.

The law is `wheel_ref = turn(s ahead) - K (errors - errors of the turn)`. The turn is the car's own
(`Turning`), so an understeering car gets more steering, the heading error that every turn's slip
brings is not fought, and a changing curvature is followed without offset. `s ahead` is where the
car will be when the reference has reached the wheel. See `docs/explanation/controller.md`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from steerd.car_model.path.path import Path, Projection, interpolate, wrap_angle
from steerd.car_model.state import State
from steerd.controller.gain_table import N_LANE, N_TURNING
from steerd.controller.live import AS_DESIGNED, LiveValues, shift_curvature

SQUEEZE_MIN = 0.1  # least 1 - curvature e1: the errors' rates mean nothing at the turn's centre

SLOPE_SPAN_MIN = 0.05  # shortest distance over which the change of curvature is taken [m]


class LaneErrors(NamedTuple):
    """Where the car is against the lane."""

    e1: float  # lateral offset of the CoG [m], positive to the left
    e1_rate: float  # [m/s]
    e2: float  # heading error, yaw minus the path's direction [rad], in (-pi, pi]
    e2_rate: float  # [rad/s]


class LaneKeeper(NamedTuple):
    """The constants of the steering law."""

    path: Path
    preview_s: float  # time from an order to the wheel having followed: dead time and lag [s]
    wheel_min: float  # [rad]
    wheel_max: float  # [rad]


def lane_errors(estimate: State[float], at: Projection) -> LaneErrors:
    """Errors of the CoG against the path at its projection.

    `e1' = v sin(e2 + slip)`; `e2' = yaw rate - k s'` with `s' = v cos(e2 + slip) / (1 - k e1)`.
    """
    e2 = wrap_angle(estimate.yaw - at.yaw_path)
    course = e2 + estimate.slip_angle
    squeeze = max(1.0 - at.curvature * at.e1, SQUEEZE_MIN)
    along = estimate.speed * math.cos(course) / squeeze
    return LaneErrors(
        e1=at.e1,
        e1_rate=estimate.speed * math.sin(course),
        e2=e2,
        e2_rate=estimate.yaw_rate - at.curvature * along,
    )


def step(
    keeper: LaneKeeper,
    row: Sequence[float],
    errors: LaneErrors,
    at: Projection,
    estimate: State[float],
    past: Sequence[float],
    live: LiveValues = AS_DESIGNED,
) -> tuple[float, float]:
    """One tick of the steering law, with the gain table's row at the estimate's speed.

    `past` holds the references within the dead time less their feed-forward [rad], newest first.
    By the live offset, errors and projection are shifted already.

    Returns:
        The reference of the road-wheel angle [rad], within the car's end stops, and its part from
        the path's curvature [rad].
    """
    wheel, wheel_change, heading, heading_change = row[-N_TURNING:]
    speed = max(estimate.speed, 0.0)
    preview = speed * keeper.preview_s
    span = max(preview, SLOPE_SPAN_MIN)
    ahead = interpolate(keeper.path, keeper.path.curvature, at.s + span)
    slope = (shift_curvature(ahead, live.offset) - at.curvature) / span
    change = speed * slope
    turn_wheel = wheel * at.curvature + wheel_change * change
    feedforward = turn_wheel + wheel * slope * preview
    feedback = (
        row[0] * errors.e1
        + row[1] * errors.e1_rate
        + row[2] * (errors.e2 - heading * at.curvature - heading_change * change)
        + row[3] * (errors.e2_rate - heading * change)
        + row[4] * (estimate.steer - turn_wheel)
    )
    for gain, deviation in zip(row[N_LANE:-N_TURNING], past, strict=True):
        feedback += gain * deviation
    reference = max(keeper.wheel_min, min(keeper.wheel_max, feedforward - live.gain * feedback))
    return reference, feedforward
