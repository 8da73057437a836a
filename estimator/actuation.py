"""What the actuators do between two instants, from the commands that were sent.

Each command reaches steering and drive after its own dead time, so the commands of the past are
kept; between the instants at which one arrives, `car_model.actuate` is exact.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple, cast

from steerd.car_model.actuators import actuate, references
from steerd.car_model.params import Car
from steerd.car_model.state import Command, State
from steerd.car_model.straight_line import compiled
from steerd.car_model.tape import TAPE, Node, Tape, apply, gradient

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


class ActuatorMotion(NamedTuple):
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


GIVEN = ("steer_cmd", "steered", "speed_cmd", "driven", "speed", "h")
"""What a piece of an interval is given: orders, 1 or 0 for whether they were given, the speed at
the interval's beginning, and how long the piece is."""
SO_FAR = ("steer", "turned", "gained", "by_steer", "by_speed", "turned_by_steer")
"""What goes from piece to piece: angle, its integral, speed gained, and their derivatives."""


def recorded_piece(tape: Tape, car: Car[Node]) -> tuple[list[Node], list[Node]]:
    """`actuate` over a piece of an interval without a change of order, and its derivatives.

    Returns:
        The inputs, `GIVEN` and then `SO_FAR`, and the outputs: `SO_FAR` after the piece.
    """
    inputs = [tape.symbol(name) for name in (*GIVEN, *SO_FAR)]
    steer_cmd, steered, speed_cmd, driven, speed, h = inputs[: len(GIVEN)]
    steer, turned, gained, by_steer, by_speed, turned_by_steer = inputs[len(GIVEN) :]
    fast = speed + gained
    still: State[Any] = State(*map(tape.constant, [0.0] * 7))
    now = still._replace(speed=fast, steer=steer)
    ref = references(TAPE, car, Command(steer_cmd, speed_cmd))
    out = actuate(TAPE, car, now, ref, cast("float", h))
    (after_by_steer,) = gradient([(out.steer, 1.0)], [steer])
    (accel_by_speed,) = gradient([(out.accel, 1.0)], [fast])
    after = apply("select", steered, out.steer, steer)
    after_by_steer = apply("select", steered, after_by_steer, 1.0)
    accel = apply("select", driven, out.accel, 0.0)
    accel_by_speed = apply("select", driven, accel_by_speed, 0.0)
    half = 0.5 * h
    return inputs, [
        after,
        turned + half * (steer + after),
        gained + h * accel,
        by_steer * after_by_steer,
        by_speed * (1.0 + h * accel_by_speed),
        turned_by_steer + half * by_steer * (1.0 + after_by_steer),
    ]


@lru_cache(maxsize=32)
def _piece(car: Car[float]) -> Callable[..., tuple[float, ...]]:
    """A piece of an interval for this car, recorded and compiled."""
    tape = Tape()
    return compiled(*recorded_piece(tape, Car(*map(tape.constant, car))))
