"""What is free, drives that do not stand in a search's way, and where it begins.

At low lateral acceleration the path's curvature is the tangent of `steer_gain` times the command
over the wheelbase (Rajamani, Vehicle Dynamics and Control, section 2.2), so the gain per wheelbase
is known before any simulation. Which of the two, the drives barely say: a stated wheelbase gives
the gain; without one the commands are taken as the wheels' angles, as far as wheels turn so far.
"""

# Why: docs/decisions/identification.md#d59

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Literal

import numpy as np

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import GRAVITY, Car, wheelbase
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import HISTORY as PAST
from steerd.sysid.data.dataset import Run, pose_rates
from steerd.sysid.data.excitation import SPEED_SPAN, measure_excitation
from steerd.sysid.inference.car_fit import Stated
from steerd.sysid.inference.identifiability import ANOTHER_END, Estimate

_RESTS = 1e-3  # steering that changes by less from one step of the grid to the next rests [rad]
HISTORY = 4.0  # commands before a window that a linkage with play may remember [s]
_BARELY = 1.05  # a slew limit that is passed by less makes no difference
AGREE = 5e-4  # lengths that agree to this are the same measurement [m]
_ROOM = 1.5  # a gain that is not known yet may be so much larger


Method = Literal["ours", "paper", "cma-es"]


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What is learnt, and how."""

    # The only effects of the library that may be learnt with the car; empty or `auto` for all that
    # the drives show (empty with `free`: none but those)
    effects: Sequence[str] | Literal["auto"] = ()
    free: Sequence[str] = ()  # parameters to fit; empty for all that the drives can hold
    # Parameters that keep the start value (None) or take this one, in SI units
    fix: Mapping[str, float | None] = field(default_factory=dict)
    wheelbase: float | None = None  # measured distance of the axles [m]
    method: Method = "ours"  # or the paper's `paper` and `cma-es`
    starts: int | None = None  # how many starts; None for 1 (ours) or 5
    iterations: int | None = None  # of the paper's methods; None for 100 (`paper`) or 500
    seed: int = 0  # of random starts
    jobs: int = 1  # worker processes


def add_command_history(runs: Sequence[Run], model: Model[float]) -> tuple[Run, ...]:
    """The drives, with more of the commands before a window where a linkage may remember them.

    One with play remembers on which side of it the last turn left it. Whether a car has play is
    asked of drives that hold their steering still.
    """
    plays = any(effect.remembers_commands for effect in model.effects)
    return tuple(
        replace(run, history=HISTORY) if plays or holds_still(run) else run for run in runs
    )


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
    """The car without load shift where a measured speed, whose slope is noise, is prescribed."""
    commanded = all(run.speed_source == "command" for run in runs)
    return model if commanded else model._replace(car=model.car._replace(cog_height=0.0))


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


# -- where the search begins -----------------------------------------------------------------------

GENTLE = 2.0  # lateral acceleration below which tyres barely slip [m/s^2]
SPEED_MIN = 0.3  # slower, the curvature of noisy poses says nothing [m/s]
DELAYS: Array = np.arange(0.0, 0.41, 0.02)  # delays from command to curvature that are tried [s]
FEW = 50  # poses that must be left
WIDEST = 0.7  # no wheel turns further; commands beyond it have a unit of their own [rad] ...
LOCK = 0.4  # ... and at their largest turn the wheel to an ordinary car's lock [rad]
NEAR = 0.1  # a start whose curvature per command is right to this share is as good as another
_HELD = 0.3  # weight of a bias of zero: what steady commands explain is not what wheels are off by
_LARGE = 0.3  # curvatures that are off by more than this share of the sharpest count for less
_STEPS = 10
_REARWARD = 0.7  # one candidate's centre of gravity lies closer to the rear axle by this factor
_LATER, _QUICKER = 0.02, 0.6
"""Another's servo waits so much longer [s], and then follows faster by this factor."""
SLIDING, TYRES = 0.75, ((1.0, 0.5), (3.0, 0.5))
"""Share of the floor's grip from which tyres' forces are no longer in proportion to slip, and
curves of such tyres: parameters of `tyre_saturation`."""
START_SPREAD = 0.3  # further starts lie about the first with this relative standard deviation


def possible_starts(
    model: Model[float], runs: Sequence[Run], stated: Stated
) -> tuple[Model[float], ...]:
    """The car as given, and before it one of the size, or the gain, that the curvature asks for.

    Hard drives barely show it, so both are starts; the drives choose.
    """
    car, length, gain = model.car, wheelbase(model.car), model.car.steer_gain
    known = stated.wheelbase or bool({"lf", "lr"} & set(stated.held))
    if known and stated.holds("steer_gain"):
        return (model,)
    if known:
        scale, new = 1.0, steering_gain(runs, length)
    else:
        widest = gain * largest_steering(runs)
        own_unit = widest > WIDEST and not stated.holds("steer_gain")
        new = gain * LOCK / widest if own_unit else gain
        scale = rolling_length(runs, new) / length
    if not (scale > 0.0 and new > 0.0) or abs(np.log(new / scale / gain)) < NEAR:
        return (model,)
    moved = car._replace(
        lf=car.lf * scale, lr=car.lr * scale, inertia_z=car.inertia_z * scale**2,
        cog_height=car.cog_height * scale, steer_gain=new,
    )  # fmt: skip
    return (model._replace(car=moved), model)


def slides(models: Sequence[Model[float]], runs: Sequence[Run], stated: Stated) -> bool:
    """Whether tyres are so near the limit of grip that their curve is not known beforehand."""
    lateral = measure_excitation(runs).lateral_accel
    known = stated.holds("tyre_saturation")
    return not known and any(lateral > SLIDING * m.car.mu * GRAVITY for m in models)


def sliding_starts(models: Sequence[Model[float]]) -> list[Model[float]]:
    """The starts on tyres that never level off, and on some that do.

    On tyres whose force grows with slip for ever the search ends at a car that spins.
    """
    found = []
    for tyres in ((), *TYRES):
        for model in models:
            own = dict(zip(model.effects, model.values, strict=True))
            own[EFFECTS["tyre_saturation"]] = tyres
            kept = {e: values for e, values in own.items() if values}
            found.append(model._replace(effects=tuple(kept), values=tuple(kept.values())))
    return found


def steering_gain(runs: Sequence[Run], length: float) -> float:
    """Wheel angle per command of a car of this wheelbase; nan where drives do not show it."""
    return _slope(runs, lambda command: command, lambda bend: np.arctan(length * bend))


def rolling_length(runs: Sequence[Run], gain: float) -> float:
    """Wheelbase of a car whose wheels turn by `gain` per command [m]; nan as above."""
    bend = _slope(runs, lambda command: np.tan(gain * command), lambda bend: bend)
    return 1.0 / bend if bend else float("nan")


def _slope(
    runs: Sequence[Run], cause: Callable[[Array], Array], effect: Callable[[Array], Array]
) -> float:
    """Slope from functions of commands to those of curvature, at the delay that explains most."""
    gentle = [_gentle(run) for run in runs]
    seen = effect(np.concatenate([each for _, each in gentle]))
    if len(seen) < FEW or not (scale := _LARGE * float(np.percentile(np.abs(seen), 95.0))):
        return float("nan")
    lines = []
    for delay in DELAYS:
        commands = [
            np.interp(t - delay, run.h * np.arange(len(run.commands)), run.commands[:, 0])
            for run, (t, _) in zip(runs, gentle, strict=True)
        ]
        lines.append(_line(cause(np.concatenate(commands)), seen, scale))
    return min(lines)[1]


def _gentle(run: Run) -> tuple[Array, Array]:
    """Times [s] and curvatures [1/m] of a drive, forward and where tyres barely slip."""
    t, speed, rate = pose_rates(run.pose)
    kept = (speed > SPEED_MIN) & (np.abs(speed * rate) < GENTLE)
    return t[kept], rate[kept] / speed[kept]


def _line(cause: Array, effect: Array, scale: float) -> tuple[float, float]:
    """Bounded cost and slope of the line through the points, with a bias that is held small."""
    basis = np.column_stack([cause, np.ones_like(cause)])
    weight, off, line = np.ones_like(effect), effect, np.zeros(2)
    held = np.diag([1e-9, _HELD]) * len(cause)
    for _ in range(_STEPS):
        weighed = weight[:, None] * basis
        line = np.linalg.solve(weighed.T @ basis + held, weighed.T @ effect)
        off = (effect - basis @ line) / scale
        weight = 1.0 / (1.0 + off**2)
    return float(np.log1p(off**2).mean()), float(line[0])


def scatter(model: Model[float], free: Sequence[str], count: int, seed: int) -> list[Model[float]]:
    """The model and random ones about it; only lengths, stiffnesses and inertia move."""
    rng = np.random.default_rng(seed)
    moving = [n for n in free if n in ("lf", "lr", "c_sf", "c_sr", "inertia_z")]
    models = [model]
    for _ in range(count - 1):
        factors = np.exp(START_SPREAD * rng.standard_normal(len(moving))).tolist()
        moved = {n: getattr(model.car, n) * f for n, f in zip(moving, factors, strict=True)}
        models.append(model._replace(car=model.car._replace(**moved)))
    return models


def has_one_speed(runs: Sequence[Run]) -> bool:
    """Whether the drives have barely more than one speed."""
    driven = measure_excitation(runs)
    return driven.speed_high - driven.speed_low < SPEED_SPAN


def candidate_starts(model: Model[float], free: Sequence[str]) -> list[Model[float]]:
    """The start, and others along what one speed leaves open; what is not free stays."""
    car = model.car
    lr = _REARWARD * car.lr
    delay, lag = car.steer_delay + _LATER, _QUICKER * car.steer_lag
    others = []
    if "lf" in free and "lr" in free:
        others.append(car._replace(lf=car.lf + car.lr - lr, lr=lr))
    if "steer_delay" in free and "steer_lag" in free:
        others.append(car._replace(steer_delay=delay, steer_lag=lag))
    return [model, *(model._replace(car=other) for other in others)]


def mark_ambiguous(
    found: dict[str, Estimate], others: Sequence[dict[str, Estimate]]
) -> dict[str, Estimate]:
    """The estimates, with what others, as good as they, place elsewhere marked as open."""
    marked = dict(found)
    for name, e in found.items():
        moved = max((abs(other[name].value - e.value) for other in others), default=0.0)
        if moved > e.sd:
            why = e.manoeuvre or ANOTHER_END
            marked[name] = replace(e, sd=moved, identifiable=False, manoeuvre=why)
    return marked
