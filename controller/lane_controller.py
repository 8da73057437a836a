"""The controller's tick: an estimate in, a command and a report out, pure and in plain floats."""

import math
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.car_model.path.path import locate, project
from steerd.car_model.state import Command, State
from steerd.controller import lane_keeper
from steerd.controller.config import ControllerConfig
from steerd.controller.design import DesignReport
from steerd.controller.gain_table import GainTable, look_up
from steerd.controller.lane_keeper import LaneKeeper, lane_errors
from steerd.controller.live import AS_DESIGNED, LiveValues, limit_target, shift_lane
from steerd.controller.speed import SpeedProfile, preview_place, profile_speed, step_speed

STEP_MAX_S = 0.1  # longest time that one tick's speed ramp is granted for [s]: a pause is no leap


class LaneController(NamedTuple):
    """Everything a tick needs, made once by `steerd.controller.build.make_controller`."""

    car: Car[float]
    config: ControllerConfig
    table: GainTable
    keeper: LaneKeeper
    profile: SpeedProfile
    report: DesignReport  # what was designed and how stable it is


class ControllerState(NamedTuple):
    """What one tick leaves to the next."""

    hint: int  # path sample next to the car
    past: tuple[float, ...]
    """References within the dead time less their feed-forward [rad], newest first."""
    feedforward: float  # of the last tick [rad]
    speed: float  # speed reference [m/s]
    t_ns: int  # of the last tick [ns]


class ControlReport(NamedTuple):
    """What a tick saw and decided."""

    e1: float  # lateral offset from the lane that is followed [m]
    e1_rate: float  # [m/s]
    e2: float  # heading error [rad]
    e2_rate: float  # [rad/s]
    s: float  # arc length of the car's place on the path [m]
    curvature: float  # of the path there [1/m]
    distance: float  # to the path [m]; exceeds `|e1|` beyond an open path's ends
    wheel: float  # reference of the road-wheel angle [rad]
    feedforward: float  # its part from the path's curvature [rad]
    speed: float  # speed reference [m/s]


def start_controller(
    controller: LaneController, estimate: State[float], t_ns: int
) -> ControllerState:
    """The state before the first tick, also for a restart: searches the whole path.

    The speed reference starts from the car's own speed.
    """
    found = locate(controller.keeper.path, estimate.x, estimate.y, estimate.yaw)
    past = (0.0,) * controller.table.pasts
    return ControllerState(found.hint, past, 0.0, max(estimate.speed, 0.0), t_ns)


def control(
    controller: LaneController,
    state: ControllerState,
    estimate: State[float],
    t_ns: int,
    *,
    issued: Command[float] | None = None,
    stop: bool = False,
    live: LiveValues = AS_DESIGNED,
) -> tuple[Command[float], ControlReport, ControllerState]:
    """One tick at `t_ns` (CLOCK_MONOTONIC [ns]), after `start_controller` or the last one.

    `issued` is the last tick's command after the output limiter; without it the design assumes that
    the command left unchanged. `stop` ramps the speed reference down to rest, lane keeping on.

    Raises:
        ValueError: the estimate is not finite.
    """
    if not math.isfinite(sum(estimate)):
        raise ValueError(f"the estimate is not finite: {estimate}")
    past = state.past if issued is None else _correct_newest(controller.car, state, issued)
    path = controller.keeper.path
    at = shift_lane(project(path, estimate.x, estimate.y, state.hint), live.offset)
    errors = lane_errors(estimate, at)
    row = look_up(controller.table, estimate.speed)
    wheel, feedforward = lane_keeper.step(controller.keeper, row, errors, at, estimate, past, live)
    dt = min(max((t_ns - state.t_ns) * 1e-9, 0.0), STEP_MAX_S)
    ahead = preview_place(controller.profile, at.s, estimate.speed)
    ramp = state.speed - controller.config.stop_ramp * dt  # a lower speed is no emergency
    cap = live if live.speed >= ramp else LiveValues(ramp, live.offset, live.gain)
    target = profile_speed(controller.profile, at.s, estimate.speed)
    target = limit_target(target, path, ahead, cap, controller.config)
    speed = step_speed(state.speed, target, dt, controller.config, stop)
    command = to_command(controller.car, wheel, speed)
    place = (at.s, at.curvature, at.distance)
    report = ControlReport(*errors, *place, wheel, feedforward, speed)
    past = (wheel - feedforward, *past[:-1]) if past else past
    return command, report, ControllerState(at.hint, past, feedforward, speed, t_ns)


def to_command(car: Car[float], wheel: float, speed: float) -> Command[float]:
    """The command that makes the car's actuators aim at a wheel angle [rad] and a speed [m/s].

    Inverse of `steerd.car_model.actuators.references` within the end stops.
    """
    return Command((wheel - car.steer_bias) / car.steer_gain, speed / car.speed_gain)


def _correct_newest(
    car: Car[float], state: ControllerState, issued: Command[float]
) -> tuple[float, ...]:
    """The references within the dead time with the newest as it really left."""
    if not state.past:
        return state.past
    wheel = car.steer_gain * issued.steer + car.steer_bias
    wheel = max(car.steer_min, min(car.steer_max, wheel))
    return (wheel - state.feedforward, *state.past[1:])
