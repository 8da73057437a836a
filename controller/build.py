"""Making a controller at start: design, check, refuse. Only this leads to python-control."""

from collections.abc import Iterator
from dataclasses import replace

from car_model.params import Car
from car_model.path import Path
from controller.config import ControllerConfig
from controller.design import (
    DesignRefused,
    DesignReport,
    Stability,
    assess,
    delay_margin,
    describe_timing,
    find_fault,
)
from controller.gain_table import N_TURNING, GainTable, look_up
from controller.gains import design_table
from controller.lane_controller import LaneController
from controller.lane_keeper import LaneKeeper
from controller.loop_model import Timing
from controller.speed import SpeedProfile, make_speed_profile

RATES_TRIED = (2.0, 4.0)
"""Multiples of the rate that a refusal tries before it advises."""


def make_controller(
    car: Car[float],
    path: Path,
    config: ControllerConfig,
    rate_hz: float,
    delay_s: float | None = None,
) -> LaneController:
    """Designs for this car, path, rate and delay, and checks the closed loop.

    Args:
        car: as identified; its `steer_lag` is the servo's.
        path: to follow.
        config: settings.
        rate_hz: ticks per second.
        delay_s: whole dead time of the steering loop [s], from the moment an estimate is about to
            the wheel beginning to follow; `car.steer_delay` if it was not measured.

    Raises:
        DesignRefused: a speed at which the closed loop is unstable or too little damped.
        ValueError: the path turns tighter than the car can, or rate and delay make no sense.
    """
    delay = car.steer_delay if delay_s is None else delay_s
    if not (0.0 < rate_hz <= 1e4 and 0.0 <= delay <= 1.0):
        raise ValueError(f"rate {rate_hz} Hz, delay {delay} s: use 0 < rate and 0 <= delay <= 1")
    timing = Timing(rate_hz, delay, car.steer_lag)
    profile = make_speed_profile(car, path, config)
    table, stabilities = _designed(car, config, timing, profile.fastest)
    _require_turnable(car, path, profile, table)
    report = DesignReport(config.design, timing, stabilities, delay_margin(car, table, timing))
    keeper = LaneKeeper(path, delay + car.steer_lag, car.steer_min, car.steer_max)
    return LaneController(car, config, table, keeper, profile, report)


def _designed(
    car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float
) -> tuple[GainTable, tuple[Stability, ...]]:
    """Gains that passed the check."""
    table = design_table(car, config, timing, speed_max)
    stabilities = assess(car, table, timing)
    fault = find_fault(stabilities, config.damping_min)
    if fault is not None:
        advice = "; ".join(_advice(car, config, timing, speed_max, stabilities))
        raise DesignRefused(f"{_complaint(config, timing, fault)}. Try {advice}")
    return table, stabilities


def _complaint(config: ControllerConfig, timing: Timing, fault: Stability) -> str:
    why = (
        f"spectral radius {fault.radius:.2f} (unstable from 1 on)"
        if fault.radius >= 1.0
        else f"damping {fault.damping:.2f} (less than {config.damping_min:g}; spectral radius "
        f"{fault.radius:.3f})"
    )
    return (
        f"design {config.design!r} refused at {fault.speed:.2f} m/s, {describe_timing(timing)}: "
        f"the closed loop has {why}"
    )


def _advice(
    car: Car[float],
    config: ControllerConfig,
    timing: Timing,
    speed_max: float,
    stabilities: tuple[Stability, ...],
) -> Iterator[str]:
    """Changes that were tried and pass the check, then those that only a person can make."""
    if config.design != "lqr":
        lqr = replace(config, design="lqr")
        if _passes(car, lqr, timing, speed_max):
            yield "design = 'lqr' (passes here)"
    for factor in RATES_TRIED:
        if _passes(car, config, timing._replace(rate_hz=factor * timing.rate_hz), speed_max):
            yield f"{factor * timing.rate_hz:g} Hz (passes)"
            break
    slow = [at.speed for at in stabilities]
    fault = find_fault(stabilities, config.damping_min)
    if fault is not None and fault.speed > slow[0]:
        below = slow[slow.index(fault.speed) - 1]
        yield f"speed = {below:.2f} or less"
    yield "slower poles" if config.design != "lqr" else "a larger weights.effort"


def _passes(car: Car[float], config: ControllerConfig, timing: Timing, speed_max: float) -> bool:
    try:
        stabilities = assess(car, design_table(car, config, timing, speed_max), timing)
    except DesignRefused:
        return False
    return find_fault(stabilities, config.damping_min) is None


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
