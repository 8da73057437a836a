"""Where the search for a car that nobody here built begins: at a car of the drives' own size.

At low lateral acceleration a car follows its wheels: the path's curvature is the tangent of
`steer_gain` times the command over the wheelbase (Rajamani, Vehicle Dynamics and Control, section
2.2). So the gain per wheelbase is known before any simulation.
Which of the two, the drives barely say: a wheelbase that is stated gives the gain; without one the
commands are taken as the wheels' angles, as far as wheels turn so far.
At one speed more than one car explains a drive: hence further starts, and estimates that their ends
do not agree on.
"""

# Why: docs/decisions/identification.md#d59

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import GRAVITY, wheelbase
from steerd.sysid.data.dataset import Run, pose_rates
from steerd.sysid.data.excitation import SPEED_SPAN, measure_excitation
from steerd.sysid.inference.car_fit import Stated
from steerd.sysid.inference.identifiability import ANOTHER_END, Estimate

Array = NDArray[np.float64]

GENTLE = 2.0
"""Lateral acceleration below which tyres barely slip [m/s^2]."""
SPEED_MIN = 0.3
"""Slower, the curvature of noisy poses says nothing [m/s]."""
DELAYS: Array = np.arange(0.0, 0.41, 0.02)
"""Delays from command to curvature that are tried [s]."""
FEW = 50
"""Poses that must be left."""
WIDEST = 0.7
"""No car's wheel turns further; commands that go beyond it have a unit of their own [rad] ..."""
LOCK = 0.4
"""... and at their largest turn the wheel to an ordinary car's lock [rad]."""
NEAR = 0.1
"""A start whose curvature per command is right to this share is as good as another."""
_HELD = 0.3
"""Weight of a bias of zero: what steady commands explain is not what wheels are off by."""
_LARGE = 0.3
"""Curvatures that are off by more than this share of the sharpest bend's count for less."""
_STEPS = 10
COMPARABLE = 12.5
"""Ends whose log-likelihoods differ by less (5 standard deviations) explain drives as well."""
_REARWARD = 0.7
"""One candidate's centre of gravity lies closer to the rear axle by this factor."""
_LATER, _QUICKER = 0.02, 0.6
"""Another's servo waits so much longer [s], and then follows faster by this factor."""
SLIDING = 0.75
"""Share of the floor's grip from which tyres' forces are no longer in proportion to slip ..."""
TYRES = (1.0, 0.5), (3.0, 0.5)
"""... and curves of such tyres: parameters of `tyre_saturation`."""
START_SPREAD = 0.3
"""Further starts lie about the first with this relative standard deviation."""


def possible_starts(
    model: Model[float], runs: Sequence[Run], stated: Stated
) -> tuple[Model[float], ...]:
    """The car as given, and before it one of the size, or the gain, that the curvature asks for.

    Hard drives barely show it, so both are starts; the drives choose.

    Args:
        model: the car as given, of any size.
        runs: drives.
        stated: what keeps the model's value.
    """
    length, gain = wheelbase(model.car), model.car.steer_gain
    known = stated.wheelbase or bool({"lf", "lr"} & set(stated.held))
    if known and stated.holds("steer_gain"):
        return (model,)
    if known:
        scale, new = 1.0, steering_gain(runs, length)
    else:
        widest = gain * max(float(np.abs(run.commands[:, 0]).max()) for run in runs)
        own_unit = widest > WIDEST and not stated.holds("steer_gain")
        new = gain * LOCK / widest if own_unit else gain
        scale = rolling_length(runs, new) / length
    if not (scale > 0.0 and new > 0.0) or abs(np.log(new / scale / gain)) < NEAR:
        return (model,)
    return (_with(model, scale, new), model)


def sliding_starts(
    models: Sequence[Model[float]], runs: Sequence[Run], stated: Stated
) -> tuple[Model[float], ...]:
    """The starts on tyres that level off, where drives come near the limit of grip; else none.

    On tyres whose force grows with slip for ever the search ends at a car that spins.
    """
    effect, lateral = EFFECTS["tyre_saturation"], measure_excitation(runs).lateral_accel
    return tuple(
        model._replace(effects=(*model.effects, effect), values=(*model.values, tyres))
        for tyres in TYRES
        for model in models
        if lateral > SLIDING * model.car.mu * GRAVITY
        and effect not in model.effects
        and not stated.holds(effect.name)
    )


def _with(model: Model[float], scale: float, gain: float) -> Model[float]:
    """The model so many times as long, of the same mass, and with a steering gain."""
    car = model.car
    return model._replace(
        car=car._replace(
            lf=car.lf * scale,
            lr=car.lr * scale,
            inertia_z=car.inertia_z * scale**2,
            cog_height=car.cog_height * scale,
            steer_gain=gain,
        )
    )


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
    return {name: _mark(name, e, others) for name, e in found.items()}


def _mark(name: str, found: Estimate, others: Sequence[dict[str, Estimate]]) -> Estimate:
    moved = max((abs(o[name].value - found.value) for o in others), default=0.0)
    if moved <= found.sd:
        return found
    return replace(found, sd=moved, identifiable=False, manoeuvre=found.manoeuvre or ANOTHER_END)
