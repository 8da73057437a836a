"""Drives and a start that do not stand in a search's way: end stops, inertia, loads, history."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from steerd.car_model.model import Model
from steerd.car_model.params import Car, wheelbase
from steerd.sysid.data.dataset import HISTORY as PAST
from steerd.sysid.data.dataset import Run

_RESTS = 1e-3
"""Steering that changes by less from one step of the grid to the next rests [rad]."""
HISTORY = 4.0
"""Commands before a window that a linkage with play may remember [s]."""
_BARELY = 1.05
"""A slew limit that is passed by less makes no difference."""
_ROOM = 1.5
"""A gain that is not known yet may be so much larger."""


def add_command_history(runs: Sequence[Run], model: Model[float], asked: bool = False) -> list[Run]:
    """The drives, with more of the commands before a window where a linkage may remember them.

    Args:
        runs: the drives.
        model: the car; a linkage with play remembers on which side of it the last turn left it.
        asked: whether it is asked if the car has play: then drives that hold their steering still.
    """
    plays = any(effect.remembers_commands for effect in model.effects)
    return [
        replace(run, history=HISTORY) if plays or (asked and holds_still(run)) else run
        for run in runs
    ]


def holds_still(run: Run) -> bool:
    """Whether commanded steering that moves rests for longer than every window's own past."""
    moves = np.flatnonzero(np.abs(np.diff(run.commands[:, 0])) > _RESTS)
    if not len(moves):
        return False
    rests = np.diff(np.concatenate([[0], moves, [len(run.commands)]])) * run.h
    return bool(rests.max() > PAST)


def largest_steering(runs: Sequence[Run]) -> float:
    """Largest commanded steering angle [rad]."""
    return max(float(np.abs(run.commands[:, 0]).max()) for run in runs)


def widen_end_stops(model: Model[float], runs: Sequence[Run], free: Sequence[str]) -> Model[float]:
    """The car with end stops beyond what was asked for, where they are another car's.

    A log that steerd did not drive may be of any car, and steer in any unit of its own: the end
    stops of the start values would clip what no servo clipped.
    """
    widest = _ROOM * max(1.0, model.car.steer_gain) * largest_steering(runs)
    known = any(run.servo_frame for run in runs) or {"steer_min", "steer_max"} & set(free)
    if known or widest <= min(-model.car.steer_min, model.car.steer_max):
        return model
    return model._replace(car=model.car._replace(steer_min=-widest, steer_max=widest))


def exceeds_slew_rate(model: Model[float], runs: Sequence[Run]) -> bool:
    """Whether commands ask the wheel to turn faster than its slew limit lets it.

    How fast it really turns then decides what follows, and the file's limit is seldom this
    servo's. Drives of steerd's own keep below the limit of their car.
    """
    car = model.car
    return any(_fastest(run, car) > _BARELY * car.steer_rate for run in runs)


def _fastest(run: Run, car: Car[float]) -> float:
    """Largest rate that a wheel with a lag alone would turn at [rad/s]."""
    keeps = float(np.exp(-run.h / max(car.steer_lag, run.h)))
    steer = (car.steer_gain * run.commands[:, 0]).tolist()
    wheel = list(accumulate(steer, lambda angle, aim: aim + keeps * (angle - aim)))
    return float(np.abs(np.diff(wheel)).max()) / run.h


def restore_end_stops(car: Car[float], given: Car[float], runs: Sequence[Run]) -> Car[float]:
    """The car with the end stops it was given, moved out to where the drives went beyond them."""
    asked = np.concatenate([run.commands[:, 0] for run in runs])
    low, high = car.steer_gain * float(asked.min()), car.steer_gain * float(asked.max())
    side = max(-low, high) + abs(car.steer_bias)
    return car._replace(steer_min=min(given.steer_min, -side), steer_max=max(given.steer_max, side))


def scale_inertia(model: Model[float], known: Model[float]) -> Model[float]:
    """The car with the yaw inertia of another, in proportion to mass and length squared."""
    length = wheelbase(model.car) / wheelbase(known.car)
    scale = model.car.mass / known.car.mass * length**2
    return model._replace(car=model.car._replace(inertia_z=known.car.inertia_z * scale))


def level_loads(model: Model[float], runs: Sequence[Run]) -> Model[float]:
    """The car without load shift where a measured speed is prescribed.

    The acceleration of a measured speed is mostly noise; `steerd diagnose` leaves it out as well.
    """
    if all(run.speed_source == "command" for run in runs):
        return model
    return model._replace(car=model.car._replace(cog_height=0.0))
