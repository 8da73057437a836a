"""Figure-eights of the blind test's four-wheel car, which changes while it drives."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.blind_gap.car import PlantCar
from benchmarks.blind_gap.drives import LEAD, make_noise, make_route
from benchmarks.blind_gap.effects import EFFECTS, Values
from benchmarks.blind_gap.plant import STEP, TICK, Orders, motor_speed, simulate
from steerd.sim_gap.online.samples import Ordered, PoseSeen, Rolled, Sample

PUSH = 0.3
"""Disturbances per those of the blind test, as for foreign cars."""
ACCEL = 3.0
"""Lateral acceleration that the route's driver keeps to [m/s^2]."""
_WHEEL_SD = 0.01
_LEAD_TICKS = LEAD // TICK


@dataclass(frozen=True, slots=True)
class Change:
    """What happens to a car: its name, when [s], and the car afterwards."""

    name: str
    at: float
    later: PlantCar


CHANGES: dict[str, Values] = {
    "steer_gain": {"gain": 0.88},
    "steer_bias": {"bias": 0.02},
    "steer_delay": {"delay": 0.04},
    "steer_lag": {"lag": 0.08},
    "steer_backlash": {"play": 0.03},
    "tyre_friction": {"ratio": 0.6},
    "speed_scale": {"scale": 0.95},
    "mocap_yaw": {"offset": 0.03},
    "marker_offset": {"forward": 0.03, "left": 0.0},
}
"""The nine changes, as the blind test defines its effects on the plant."""


def changed(car: PlantCar, name: str) -> PlantCar:
    """The car after one of `CHANGES`."""
    return EFFECTS[name].apply(car, CHANGES[name])


def drive(
    car: PlantCar, seconds: float, rng: np.random.Generator, change: Change | None = None
) -> Iterator[Sample]:
    """What a car sends while it laps the route at 1.5 to 2 m/s, in the order of time.

    Args:
        car: the car.
        seconds: how long it drives.
        rng: of route, speed and disturbances.
        change: what happens to it on the way.
    """
    route = np.ascontiguousarray(make_route("eight", rng))
    driven = round(seconds / (STEP * TICK))
    ticks = _LEAD_TICKS + driven
    speed = np.full(ticks, float(rng.uniform(1.5, 2.0)))
    none = np.zeros(ticks * TICK)
    orders = Orders(np.zeros(ticks), speed, route, ACCEL, none, none)
    noise = make_noise(driven * STEP * TICK, rng, process_scale=PUSH)
    step = (LEAD + round(change.at / STEP), change.later) if change else None
    heading = np.arctan2(route[1, 1] - route[0, 1], route[1, 0] - route[0, 0])
    start = np.array([route[0, 0], route[0, 1], heading, speed[0]])
    trace = simulate(car, start, LEAD, orders, noise, step)
    states = trace.states[::TICK]
    for tick in range(_LEAD_TICKS, ticks):
        t = (tick - _LEAD_TICKS) * STEP * TICK
        now = change.later if change and t >= change.at else car
        rolled = motor_speed(now, states[tick]) / (now.wheel_scale * now.speed_gain)
        yield PoseSeen(t, *trace.poses[tick].tolist())
        yield Ordered(t, *trace.commands[tick].tolist())
        yield Rolled(t, float(rolled + _WHEEL_SD * rng.standard_normal()))
