"""What the actuators do between two instants, from the commands that were sent.

Each command reaches steering and drive after its own dead time, so the commands of the past are
kept; between the instants at which one arrives, `car_model.actuate` is exact.
"""

import math
from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import NamedTuple

from car_model.ops import FLOAT
from car_model.params import Car
from car_model.single_track import LAG_FLOOR, actuate, references
from car_model.state import Command, State

NS = 1_000_000_000
SECONDS = 1e-9


class History(NamedTuple):
    """Commands in the order of their times; each holds until the next."""

    times: tuple[int, ...] = ()
    """When each was sent [ns]."""
    commands: tuple[Command[float] | None, ...] = ()
    """None: nothing was driven; the steering holds and the car rolls on."""


NO_HISTORY = History()


class Driven(NamedTuple):
    """What steering and drive did over an interval, and how that depends on where they began."""

    steer: float
    """Steering angle at the end [rad]."""
    wheel: float
    """Its mean over the interval [rad]."""
    accel: float
    """Mean longitudinal acceleration [m/s^2]."""
    steer_by_steer: float
    wheel_by_steer: float
    accel_by_speed: float
    steered: bool = True
    """False while nothing drives the servo, which then holds where it is."""


def remembered(history: History, t_ns: int, command: Command[float] | None) -> History:
    """The history with one more command, in its place; a second one of the same time wins.

    Raises:
        ValueError: if the command is not finite.
    """
    if command is not None and not all(math.isfinite(value) for value in command):
        raise ValueError(f"command is not finite: {command}")
    i, j = bisect_left(history.times, t_ns), bisect_right(history.times, t_ns)
    return History(
        (*history.times[:i], t_ns, *history.times[j:]),
        (*history.commands[:i], command, *history.commands[j:]),
    )


def forgotten(history: History, t_ns: int) -> History:
    """The history without what was over by `t_ns`; the command that holds then stays."""
    first = max(bisect_right(history.times, t_ns) - 1, 0)
    return History(history.times[first:], history.commands[first:]) if first else history


def dead_times(car: Car[float]) -> tuple[int, int]:
    """Dead time of steering and of drive [ns]."""
    return round(car.steer_delay * NS), round(car.drive_delay * NS)


def held(history: History, t_ns: int) -> Command[float] | None:
    """The command sent last at or before `t_ns`."""
    index = bisect_right(history.times, t_ns) - 1
    return history.commands[index] if index >= 0 else None


def drive(
    car: Car[float], history: History, steer: float, speed: float, start_ns: int, end_ns: int
) -> Driven:
    """Steering and drive from `start_ns` to `end_ns`, from angle `steer` and `speed`."""
    late = dead_times(car)
    turned, gained = 0.0, 0.0
    now, by_steer, by_speed, turned_by_steer = steer, 1.0, 1.0, 0.0
    cuts = _cuts(history, late, start_ns, end_ns)
    for begin, end in pairwise(cuts):
        h = (end - begin) * SECONDS
        part = _piece(car, held(history, begin - late[0]), held(history, begin - late[1]),
                      now, speed + gained, h)  # fmt: skip
        after = by_steer * part.steer_by_steer
        turned += 0.5 * h * (now + part.steer)
        turned_by_steer += 0.5 * h * (by_steer + after)
        gained += h * part.accel
        by_speed *= 1.0 + h * part.accel_by_speed
        now, by_steer = part.steer, after
    span = (end_ns - start_ns) * SECONDS
    return Driven(
        steer=now,
        wheel=turned / span,
        accel=gained / span,
        steer_by_steer=by_steer,
        wheel_by_steer=turned_by_steer / span,
        accel_by_speed=(by_speed - 1.0) / span,
        steered=held(history, end_ns - 1 - late[0]) is not None,
    )


def _cuts(history: History, late: tuple[int, int], start_ns: int, end_ns: int) -> list[int]:
    """Instants at which what the actuators aim at may change, ends included [ns]."""
    times = history.times
    inside = {
        sent + delay
        for delay in late
        for sent in times[
            bisect_right(times, start_ns - delay) : bisect_left(times, end_ns - delay)
        ]
    }
    return [start_ns, *sorted(inside), end_ns]


def _piece(
    car: Car[float],
    steering: Command[float] | None,
    driving: Command[float] | None,
    steer: float,
    speed: float,
    h: float,
) -> Driven:
    """One interval under constant commands: `actuate` and its derivatives."""
    now = State(0.0, 0.0, 0.0, speed, 0.0, 0.0, steer)
    asked = Command(steering.steer if steering else 0.0, driving.speed if driving else 0.0)
    out = actuate(FLOAT, car, now, references(FLOAT, car, asked), h)
    end, by_steer = steer, 1.0
    if steering:
        end = out.steer
        slewing = abs(end - steer) >= car.steer_rate * h * (1.0 - 1e-12)
        by_steer = 1.0 if slewing else math.exp(-h / max(car.steer_lag, LAG_FLOOR))
    accel, by_speed = 0.0, 0.0
    if driving:
        accel = out.accel
        if -car.decel_max < accel < car.accel_max:
            by_speed = math.expm1(-h / max(car.speed_lag, LAG_FLOOR)) / h
    return Driven(end, 0.5 * (steer + end), accel, by_steer, 0.5 * (1.0 + by_steer), by_speed)
