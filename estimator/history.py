"""The commands of the recent past: each reaches steering and drive after its own dead time."""

import math
from bisect import bisect_left, bisect_right
from functools import lru_cache

from steerd.car_model.params import Car
from steerd.car_model.state import Command
from steerd.steer_bus.quick_values import quick_value

NS = 1_000_000_000


@quick_value
class History:
    """Commands in the order of their times; each holds until the next."""

    times: tuple[int, ...] = ()  # when each was sent [ns]
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
