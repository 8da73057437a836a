"""What is free, and drives and a start that do not stand in a search's way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Literal

import numpy as np

from steerd.car_model.effects import EFFECTS
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
AGREE = 5e-4
"""Lengths that agree to this are the same measurement [m]."""
_ROOM = 1.5
"""A gain that is not known yet may be so much larger."""


Method = Literal["ours", "paper", "cma-es"]


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What is learnt, and how.

    Attributes:
        effects: the only effects of the library that may be learnt with the car; empty or `auto`
            for all that the drives show (empty with `free`: none but those).
        free: parameters to fit; empty for all that the drives can hold.
        fix: parameters that keep the start value (None) or take this one, in SI units.
        wheelbase: measured distance of the axles [m].
        method: `ours`, or the paper's `paper` and `cma-es`.
        starts: how many starts; None for 1 (ours) or 5.
        iterations: of the paper's methods; None for 100 (`paper`) or 500.
        seed: of random starts.
        jobs: worker processes.
        dask: address of a Dask scheduler instead.
    """

    effects: Sequence[str] | Literal["auto"] = ()
    free: Sequence[str] = ()
    fix: Mapping[str, float | None] = field(default_factory=dict)
    wheelbase: float | None = None
    method: Method = "ours"
    starts: int | None = None
    iterations: int | None = None
    seed: int = 0
    jobs: int = 1
    dask: str | None = None


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


def fit_wheelbase(
    model: Model[float], length: float | None, fixed: Sequence[str] = ()
) -> Model[float]:
    """The model with its axles at a known distance [m], in the same proportion.

    Of `fixed` lengths, one leaves the other to be what is missing; two are as they are.

    Raises:
        ValueError: fixed lengths and the distance do not agree.
    """
    if length is None:
        return model
    car = model.car
    if kept := [name for name in ("lf", "lr") if name in fixed]:
        other = length - getattr(car, kept[0])
        name = "lr" if kept[0] == "lf" else "lf"
        if other <= 0.0 or (len(kept) > 1 and abs(other - getattr(car, name)) > AGREE):
            lengths = " and ".join(f"{n} = {getattr(car, n):g}" for n in kept)
            raise ValueError(f"{lengths} do not make a wheelbase of {length:g} m")
        return model if len(kept) > 1 else model._replace(car=car._replace(**{name: other}))
    scale = length / wheelbase(model.car)
    return model._replace(car=model.car._replace(lf=model.car.lf * scale, lr=model.car.lr * scale))


def free_names(asked: FitOptions, default: Sequence[str]) -> tuple[str, ...]:
    """Free parameters after `--free` and `--fix`.

    With the distance of the axles known, one fixed length leaves nothing of the other to learn.
    """
    lengths = {"lf", "lr"} if asked.wheelbase is not None and {"lf", "lr"} & set(asked.fix) else ()
    return tuple(name for name in (asked.free or default) if name not in {*lengths, *asked.fix})


def held_names(asked: FitOptions) -> tuple[str, ...]:
    """What keeps its value: what is fixed, and all else where `--free` names what does not.

    With the distance of the axles known, the other length follows from the one that is fixed or
    free. Effects are the only ones that may be learnt; without any, `--free` decides.
    """
    effects = tuple(EFFECTS) if asked.effects == "auto" else asked.effects
    axles = ("lf", "lr") if asked.wheelbase is not None else ()
    kept = axles if set(axles) & set(asked.fix) else ()
    follows = axles if set(axles) & set(asked.free) else ()
    moving = {*asked.free, *follows, *effects}
    others = [name for name in Car._fields if name not in moving] if asked.free else []
    if asked.free or effects:  # an effect may bear the name of the parameter that it moves
        others += [name for name in EFFECTS if name not in (*moving, *Car._fields)]
    return tuple(dict.fromkeys((*asked.fix, *kept, *others)))
