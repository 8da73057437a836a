"""What the actuators do between two instants, from the commands that were sent.

Each command reaches steering and drive after its own dead time, so the commands of the past are
kept; between the instants at which one arrives, `car_model.actuate` is exact.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.car_model.prediction import ActuatorMotion, recorded_piece
from steerd.car_model.state import Command
from steerd.car_model.tape import Tape, program

NS = 1_000_000_000
SECONDS = 1e-9
_NEVER_NS = 1 << 62


class History(NamedTuple):
    """Commands in the order of their times; each holds until the next."""

    times: tuple[int, ...] = ()
    """When each was sent [ns]."""
    commands: tuple[Command[float] | None, ...] = ()
    """None: nothing was driven; the steering holds and the car rolls on."""


NO_HISTORY = History()


def add_command(history: History, t_ns: int, command: Command[float] | None) -> History:
    """The history with one more command, in its place; a second one of the same time wins.

    Raises:
        ValueError: if the command is not finite.
    """
    if command is not None and not (math.isfinite(command.steer) and math.isfinite(command.speed)):
        raise ValueError(f"command is not finite: {command}")
    if not history.times or t_ns > history.times[-1]:
        return History((*history.times, t_ns), (*history.commands, command))
    i, j = bisect_left(history.times, t_ns), bisect_right(history.times, t_ns)
    return History(
        (*history.times[:i], t_ns, *history.times[j:]),
        (*history.commands[:i], command, *history.commands[j:]),
    )


def drop_older(history: History, t_ns: int) -> History:
    """The history without what was over by `t_ns`; the command that holds then stays."""
    first = max(bisect_right(history.times, t_ns) - 1, 0)
    return History(history.times[first:], history.commands[first:]) if first else history


@lru_cache(maxsize=32)
def dead_times(car: Car[float]) -> tuple[int, int]:
    """Dead time of steering and of drive [ns]."""
    return round(car.steer_delay * NS), round(car.drive_delay * NS)


def command_at(history: History, t_ns: int) -> Command[float] | None:
    """The command sent last at or before `t_ns`."""
    index = bisect_right(history.times, t_ns) - 1
    return history.commands[index] if index >= 0 else None


def drive(
    car: Car[float], history: History, steer: float, speed: float, start_ns: int, end_ns: int
) -> ActuatorMotion:
    """Steering and drive from `start_ns` to `end_ns`, from angle `steer` and `speed`."""
    piece, times, known = _piece(car), history.times, len(history.times)
    steer_late, drive_late = dead_times(car)
    turn = bisect_right(times, start_ns - steer_late)
    push = bisect_right(times, start_ns - drive_late)
    so_far: tuple[float, ...] = (steer, 0.0, 0.0, 1.0, 1.0, 0.0)
    begin, steered = start_ns, False
    while begin < end_ns:
        next_turn = times[turn] + steer_late if turn < known else _NEVER_NS
        next_push = times[push] + drive_late if push < known else _NEVER_NS
        end = min(next_turn, next_push, end_ns)
        steering = history.commands[turn - 1] if turn else None
        driving = history.commands[push - 1] if push else None
        steered = steering is not None
        so_far = piece(
            steering.steer if steering else 0.0,
            float(steered),
            driving.speed if driving else 0.0,
            float(driving is not None),
            speed,
            (end - begin) * SECONDS,
            *so_far,
        )
        turn, push, begin = turn + (next_turn == end), push + (next_push == end), end
    now, turned, gained, by_steer, by_speed, turned_by_steer = so_far
    span = (end_ns - start_ns) * SECONDS
    return ActuatorMotion(
        steer=now,
        wheel=turned / span,
        accel=gained / span,
        steer_by_steer=by_steer,
        wheel_by_steer=turned_by_steer / span,
        accel_by_speed=(by_speed - 1.0) / span,
        steered=steered,
    )


@lru_cache(maxsize=32)
def _piece(car: Car[float]) -> Callable[..., tuple[float, ...]]:
    """A piece of an interval for this car, recorded."""
    tape = Tape()
    return program(*recorded_piece(tape, Car(*map(tape.constant, car))))
