"""Making a controller at start: design, check, refuse."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from steerd.car_model.linear import lane_error_model
from steerd.car_model.params import Car
from steerd.car_model.path.path import Path
from steerd.controller.config import ControllerConfig
from steerd.controller.design import (
    DesignRefused,
    DesignReport,
    Stability,
    assess,
    delay_margin,
    describe_timing,
    find_faults,
    gravest,
)
from steerd.controller.gain_table import N_TURNING, GainTable, look_up
from steerd.controller.gains import design_table
from steerd.controller.lane_controller import LaneController
from steerd.controller.lane_keeper import LaneKeeper
from steerd.controller.loop_model import Timing
from steerd.controller.speed import SpeedProfile, make_speed_profile

RATES_TRIED = (2.0, 4.0)  # multiples of the rate that a refusal tries before it advises
RADIUS_PLAIN = 1.005  # spectral radius that two decimals distinguish from 1
SPEED_TRIED = 0.9  # share of the lowest faulty speed that a refusal tries as top speed


def make_controller(
    car: Car[float], path: Path, config: ControllerConfig, rate_hz: float
) -> LaneController:
    """Designs for this car, path and rate, and checks the closed loop.

    The car's `steer_lag` is the servo's, its `steer_delay` the dead time of the whole loop, from
    the moment an estimate is about to the wheel beginning to follow.

    Raises:
        DesignRefused: a speed at which the closed loop is unstable or too little damped.
        ValueError: the path turns tighter than the car can, or rate and delay make no sense.
    """
    delay = car.steer_delay
    if not (0.0 < rate_hz <= 1e4 and 0.0 <= delay <= 1.0):
        raise ValueError(f"rate {rate_hz} Hz, delay {delay} s: use 0 < rate and 0 <= delay <= 1")
    timing = Timing(rate_hz, delay, car.steer_lag)
    profile = make_speed_profile(car, path, config)
    table, stabilities = _design_checked(car, config, timing, profile.fastest)
    _require_turnable(car, path, profile, table)
    report = DesignReport(config.design, timing, stabilities, delay_margin(car, table, timing))
    keeper = LaneKeeper(path, delay + car.steer_lag, car.steer_min, car.steer_max)
    return LaneController(car, config, table, keeper, profile, report)


def _design_checked(
    car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float
) -> tuple[GainTable, tuple[Stability, ...]]:
    """Gains that passed the check."""
    table = design_table(car, config, timing, speed_max)
    stabilities = assess(car, table, timing)
    faults = find_faults(stabilities, config.damping_min)
    if faults:
        advice = "; ".join(_advice(car, config, timing, speed_max, faults))
        raise DesignRefused(f"{_describe_refusal(config, timing, gravest(faults))}. Try {advice}")
    return table, stabilities


def _describe_refusal(config: ControllerConfig, timing: Timing, fault: Stability) -> str:
    radius = f"{fault.radius:.2f}" if fault.radius > RADIUS_PLAIN else f"{fault.radius:.4f}"
    why = "is unstable" if fault.radius >= 1.0 else f"has damping {fault.damping:.2f}"
    return (
        f"design {config.design!r} refused at {fault.speed:.2f} m/s, {describe_timing(timing)}: "
        f"the closed loop {why} (spectral radius {radius}, must be below 1; damping must be at "
        f"least {config.damping_min:g})"
    )


def _advice(
    car: Car[float],
    config: ControllerConfig,
    timing: Timing,
    speed_max: float,
    faults: tuple[Stability, ...],
) -> Iterator[str]:
    """Changes that were tried and pass the check, then one that only a person can weigh."""
    by_poles = config.design == "pole_placement"
    if by_poles and _passes(car, replace(config, design="lqr"), timing, speed_max):
        yield "design = 'lqr' (passes)"
    for factor in RATES_TRIED:
        if _passes(car, config, timing._replace(rate_hz=factor * timing.rate_hz), speed_max):
            yield f"{factor * timing.rate_hz:g} Hz (passes)"
            break
    slower = SPEED_TRIED * faults[0].speed
    if _passes(car, config, timing, slower):
        yield f"speed = {slower:.2f} (passes)"
    if by_poles:
        gentle = _with_own_fast_poles(car, config, speed_max)
        if _passes(car, gentle, timing, speed_max):
            poles = ", ".join(f'"{pole:.4g}"' for pole in gentle.poles)
            low = gentle.grid_speed_min
            yield f"poles = [{poles}] with grid_speed_min = {low:.2f} (passes)"
    yield "slower poles" if by_poles else "a larger weights.effort"


def _with_own_fast_poles(
    car: Car[float], config: ControllerConfig, speed: float
) -> ControllerConfig:
    """The slow half of the poles, with the car's own fast ones at the top speed.

    Gains that move the fast yaw and slip modes are large, and a servo's lag turns them around.
    """
    slow = sorted(config.poles, key=lambda pole: (abs(pole), pole.imag))[:2]
    own = np.linalg.eigvals(lane_error_model(car, speed).a)
    fast = sorted((complex(pole) for pole in own), key=abs)[2:]
    try:
        return replace(config, poles=(*slow, *fast), grid_speed_min=speed)
    except ValueError:
        return config


def _passes(car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float) -> bool:
    try:
        stabilities = assess(car, design_table(car, config, timing, speed_max), timing)
    except DesignRefused:
        return False
    return not find_faults(stabilities, config.damping_min)


def _require_turnable(car: Car[float], path: Path, profile: SpeedProfile, table: GainTable) -> None:
    """Refuses a path that needs more wheel angle than the car has."""
    for i, curvature in enumerate(path.curvature):
        wheel = look_up(table, profile.speed[i])[-N_TURNING] * curvature
        if not car.steer_min <= wheel <= car.steer_max:
            raise ValueError(
                f"path {path.name!r} turns with radius {1.0 / abs(curvature):.2f} m at s = "
                f"{i * path.step:.2f} m, which needs a wheel angle of {wheel:+.3f} rad; this car "
                f"has {car.steer_min:+.3f} to {car.steer_max:+.3f} rad. Use a larger radius (or "
                "smooth=0.02 for a noisy file)"
            )
