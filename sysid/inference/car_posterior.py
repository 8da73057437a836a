"""The posterior of a car: what drives without a gap say of it, and how sure.

The joint covariance of a fit (`car_fit`) is what a diagnosis may move. Beside it stands what these
drives show of every effect: they are the controls of every later diagnosis, for a gap that an
effect explains in a healthy car's drives is the model's error, and it comes again in the next
drives.
"""

# Why: docs/decisions/diagnosis.md#d50
# Why: docs/decisions/diagnosis.md#d121
# Why: docs/decisions/identification.md#d100

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtrc, chdtri

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import Effect
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import BasePrior, Control, inflate_each, knowledge_section
from steerd.sysid.inference.car_fit import NOTHING, FittedCar, Stated, fit_car, ratios
from steerd.sysid.inference.hypotheses import Candidate, begin, screen_effects
from steerd.sysid.inference.library import Library, slice_along
from steerd.sysid.inference.noise import noise_section
from steerd.sysid.inference.posterior import between_halves, design_effect, posterior_of
from steerd.sysid.inference.residuals import blocks_of
from steerd.sysid.inference.search import Point, minimise, stand
from steerd.sysid.inference.space import LIMITS

MODEL_ERROR: dict[str, float] = {
    "c_sf": 4.0, "c_sr": 2.3, "c_x": 2.0, "inertia_z": 4.5, "steer_gain": 2.0, "speed_gain": 2.5,
}  # fmt: skip
"""Standard errors are so many times those of the fit.

What the model misses is the same in every drive, so no spread between drives shows it: a servo of
second order looks like inertia, a foreign tyre like a stiff one. Root mean square of the errors in
the fit's standard errors on four cars each of three foreign simulators (seeds 9001 to 9004), the
wheelbase measured; of what has no true value there, as for the others at first. `speed_gain` has
that of twelve cars that were sealed once (1.7 and 1.1 on two simulators, 3.8 on one with springs).
`[knowledge]` keeps the fit's: a later drive of the same car misses the same.
"""
SLIDING, HARD, SLOW = 0.35, 6.0, 0.5
"""What a window that no car holds is said to be like [rad, m/s^2, m/s]."""
MOVED, FORWARD = "marker_offset", "marker_offset.forward"
"""The effect of a mocap body that is elsewhere on the car, and how far ahead that is."""
_NAMED = 3
_HALVINGS = 6
_BY_CHANCE = 1.0  # what an effect of two parameters gains by chance [nats]


def describe_lost(fitted: FittedCar, runs: Sequence[Run]) -> tuple[str, ...]:
    """Where the car does not hold, and how it was driven there, in a sentence; often none."""
    predictor, layout = fitted.likelihood.predictor, fitted.likelihood.predictor.layout
    lost = ratios(fitted) >= c.SPUN
    if not lost.any():
        return ()
    speed, slip = np.abs(fitted.point.x[:, 3]), np.abs(fitted.point.x[:, 5])
    why = [
        f"{text} in {int((lost & where).sum())}"
        for where, text in (
            (slip > SLIDING, f"sliding by more than {SLIDING:g} rad"),
            (predictor.lateral > HARD, f"more than {HARD:g} m/s² sideways"),
            (speed < SLOW, f"below {SLOW:g} m/s"),
        )
        if (lost & where).any()
    ]
    places = [f"{runs[layout.run[w]].name} {layout.t[w]:.1f} s" for w in np.flatnonzero(lost)]
    named = ", ".join(places[:_NAMED]) + (", ..." if len(places) > _NAMED else "")
    how = f": {', '.join(why)}" if why else ": driven like the others, so something acts there"
    return (f"the model does not hold {lost.sum()} of {len(lost)} windows of 1 s ({named}){how}",)


def refine(base: CarFile, runs: Sequence[Run], stated: Stated = NOTHING) -> CarFile:
    """The base car as drives without a gap show it: values, errors, `[noise]` and `[knowledge]`.

    Args:
        base: as identified; only its values are a start.
        runs: drives without a gap.
        stated: what keeps the base's value.

    Raises:
        FloatingPointError: the base car's simulation diverges.
        ValueError: no window sees enough poses.
    """
    fitted = fit_car(base, runs, stated)
    return file_of_fitted(base, fitted, knowledge_of(fitted))


def learn_sections(base: CarFile, runs: Sequence[Run]) -> dict[str, dict[str, Any]]:
    """`[noise]` and `[knowledge]` for a car file whose numbers stay as they are.

    Raises:
        FloatingPointError: the base car's simulation diverges.
        ValueError: no window sees enough poses.
    """
    fitted = fit_car(base, runs)
    return _tables(fitted, knowledge_of(fitted))


def _tables(fitted: FittedCar, known: BasePrior) -> dict[str, dict[str, Any]]:
    """`[noise]` and `[knowledge]`, with what the drives show of effects beside the car."""
    known = replace(known, controls=learn_controls(fitted, known))
    return {"noise": noise_section(fitted.noise), "knowledge": knowledge_section(known)}


def file_of_fitted(base: CarFile, fitted: FittedCar, known: BasePrior) -> CarFile:
    """The car file of a fit; effects that may as well be absent are left out."""
    chart = fitted.point.space.chart
    covariance = _doubtful(fitted, known.covariance)
    z, kept = _without_small(fitted, covariance)
    covariance = covariance if MOVED in kept else _as_mounted(fitted, covariance)
    p, spread = chart.parameters(z), chart.sds(z, covariance)
    free = {name: chart.names.index(name) for name in fitted.nuisance}
    car = {name: float(p[i]) for name, i in free.items() if "." not in name}
    own = dict(zip((e.name for e in base.effects), base.values, strict=True))
    own = {name: values for name, values in own.items() if name not in _structures(fitted)}
    own |= {name: tuple(p[fitted.augmented.places(name)].tolist()) for name in kept}
    chosen = [e for e in fitted.augmented.effects if e.name in own]
    sd = {name: float(spread[i]) * MODEL_ERROR.get(name, 1.0) for name, i in free.items()}
    moved = replace(
        base,
        car=base.car._replace(**car),
        effects=tuple(chosen),
        values=tuple(own[e.name] for e in chosen),
        sd={**base.sd, **{n: v for n, v in sd.items() if "." not in n or n.split(".")[0] in own}},
    )
    return replace(moved, sections={**moved.sections, **_tables(fitted, known)})


def _doubtful(fitted: FittedCar, covariance: Array) -> Array:
    """The covariance with the doubt about the place of the centre of gravity, the body's kept."""
    names, p = list(fitted.point.space.chart.free), fitted.point.parameters
    if not {"lf", "lr", FORWARD} <= set(names):
        return covariance
    axle = fitted.augmented.kernels.names.index
    wheelbase = float(p[axle("lf")] + p[axle("lr")])
    along = np.zeros(len(names))
    along[names.index("lr")], along[names.index(FORWARD)] = -wheelbase, wheelbase
    return covariance + c.COG_PLACE**2 * np.outer(along, along)


def _as_mounted(fitted: FittedCar, covariance: Array) -> Array:
    """The covariance where the mocap body is taken to be where it was mounted, within the prior.

    That the drives would have it elsewhere is either the model's error or the mounting's: what it
    makes of the other parameters counts as their error.
    """
    space = fitted.point.space
    if FORWARD not in space.chart.free:
        return covariance
    place = space.chart.free.index(FORWARD)
    own, mounted = covariance[place], space.covariance[place, place] / c.WEAK**2
    left_out = own / own[place] * (fitted.point.z[place] - space.centre[place])
    known = np.outer(own, own) / (own[place] + mounted)
    return np.asarray(covariance - known + np.outer(left_out, left_out))


def _structures(fitted: FittedCar) -> list[str]:
    """Names of the effects that were free, each once."""
    return list(dict.fromkeys(n.partition(".")[0] for n in fitted.nuisance if "." in n))


def _without_small(fitted: FittedCar, covariance: Array) -> tuple[Array, list[str]]:
    """Coordinates with every effect at its null that is not clearly elsewhere, and those kept.

    Of the cars with fewer and fewer effects it is the smallest that the likelihood ratio does not
    reject: errors as wide as what halves of the drives disagree about hide what all of them need.
    """
    point, temper = fitted.point, design_effect(fitted.likelihood, fitted.point.size)
    for gone, z, kept in reversed(_fewer_and_fewer(fitted, covariance)):
        with suppress(FloatingPointError):
            alone = stand(fitted.likelihood, point.space, z, point.x, point.size)
            if alone.cost - point.cost <= 0.5 * temper * chdtri(gone, c.CHANCE):
                return z, kept
    return point.z, _structures(fitted)


def _fewer_and_fewer(fitted: FittedCar, covariance: Array) -> list[tuple[int, Array, list[str]]]:
    """How many coordinates are at nulls, all of them, kept effects: one effect fewer each time.

    The likeliest by chance goes first; what moves with it moves to where it lies given that null.
    """
    space, augmented = fitted.point.space, fitted.augmented
    labels, z = list(space.chart.free), fitted.point.z.copy()
    nulls = {f"{e.name}.{p.name}": p.null for e in augmented.effects for p in e.parameters}
    names = {name: [i for i, n in enumerate(labels) if n.startswith(f"{name}.")]
             for name in _structures(fitted)}  # fmt: skip
    gone, found = list[int](), list[tuple[int, Array, list[str]]]()
    while names:
        chances = {}
        for name, mine in names.items():
            away = z[mine] - [nulls[labels[i]] for i in mine]
            square = float(away @ np.linalg.solve(covariance[np.ix_(mine, mine)], away))
            chances[name] = float(chdtrc(len(mine), square))
        least = max(chances, key=lambda name: chances[name])
        if chances[least] < c.CHANCE:
            break
        gone += names.pop(least)
        held = np.array([nulls[labels[i]] for i in gone])
        rest = [i for i in range(len(z)) if i not in gone]
        pull = np.linalg.solve(covariance[np.ix_(gone, gone)], held - fitted.point.z[gone])
        z[rest] = fitted.point.z[rest] + covariance[np.ix_(rest, gone)] @ pull
        z[gone] = held
        found.append((len(gone), np.clip(z, space.low, space.high), list(names)))
    return found


def knowledge_of(fitted: FittedCar) -> BasePrior:
    """Joint covariance and discrepancy of a car.

    Scores that vary more from block to block than noise makes them widen the errors (White, 1982):
    that is how a model that is wrong a little everywhere shows. So do estimates that vary more from
    half to half: a curvature does not see where a likelihood with kinks, or a bent one, ends; nor
    is a limit surer than what rules out lower ones. The covariance is positive definite: a
    direction that the drives do not show keeps its prior's width.
    """
    point, blocks = fitted.point, blocks_of(fitted.likelihood.predictor)
    pulls = point.at.weight[:, None] * point.at.g
    sums = np.zeros((int(blocks.max()) + 1, pulls.shape[1]))
    np.add.at(sums, blocks, pulls)
    covariance = inflate_each(posterior_of(point, 1.0).covariance, sums)
    least, halves = least_limits(fitted), between_halves(fitted.likelihood, point, blocks)
    lowest = [least.get(n, z) for n, z in zip(point.space.chart.free, point.z, strict=True)]
    wide = np.maximum(halves, (point.z - lowest) ** 2 / (2.0 * c.RULED_OUT))
    wider = np.sqrt(np.maximum(wide / np.diag(covariance), 1.0))
    covariance = covariance * np.outer(wider, wider)
    p, names = point.parameters, fitted.augmented.kernels.names
    values = tuple(float(p[names.index(name)]) for name in fitted.nuisance)
    return BasePrior(fitted.nuisance, covariance, values, size=point.size, least=least)


def least_limits(fitted: FittedCar) -> dict[str, float]:
    """Coordinates of limits, by name, below which the drives rule them out.

    Of a limit that nothing met no curvature says how low it may be: its prior's width would let a
    later base take for its own what these drives went beyond.
    """
    point, likelihood, found = fitted.point, fitted.likelihood, dict[str, float]()
    highest = point.cost + c.RULED_OUT * design_effect(likelihood, point.size)
    for i, name in enumerate(point.space.chart.free):
        if name in LIMITS:
            out, z = float(point.space.low[i]), point.z.copy()
            for _ in range(_HALVINGS):
                inside, z[i] = z[i], 0.5 * (out + z[i])
                error, _ = likelihood.predictor.errors(point.space.chart.parameters(z), point.x)
                loss = likelihood.reduce(point.weighed, error, point.x).loss.sum()
                if loss + point.space.prior_cost(z) > highest:
                    out, z[i] = float(z[i]), inside
            found[name] = out
    return found


def learn_controls(fitted: FittedCar, known: BasePrior) -> tuple[Control, ...]:
    """The healthy drives diagnosed against the car that they fitted, one Newton step an effect.

    Args:
        fitted: the car.
        known: what a later diagnosis will know of it.

    Raises:
        FloatingPointError: the car's simulation diverges.
    """
    wider = replace(known, covariance=c.KNOWN_WIDER**2 * known.covariance)
    augmented = replace(fitted.augmented, base=fitted.point.parameters, knowledge=wider)
    predictor = replace(fitted.likelihood.predictor, augmented=augmented)
    likelihood = replace(fitted.likelihood, predictor=predictor)
    library = Library(likelihood, fitted.nuisance, augmented.effects)
    base = minimise(likelihood, begin(library, (), (), fitted.point.x))
    temper = design_effect(likelihood, base.size, controlled=True)
    scanned = replace(library, effects=tuple(e for e in augmented.effects if e.zero_gradient))
    found = [_scanned(library, look, temper) for look in screen_effects(scanned, base)]
    linear = (_control(library, base, effect, temper) for effect in augmented.effects)
    return (*found, *filter(None, linear))


def _scanned(library: Library, look: Candidate, temper: float) -> Control:
    """What an effect gains whose derivative vanishes where it is: it stays there."""
    here = np.array(library.likelihood.predictor.augmented.values(look.effect))
    return _as_control(library, look.effect, here, np.zeros((len(here),) * 2), look.gain / temper)


def _control(library: Library, base: Point, effect: Effect, temper: float) -> Control | None:
    """Where an effect explains the drives best, were it free of bounds; within them, its gain.

    No wider than its own prior. A base whose drive is never late enough to be at its best says so
    by a dead time below zero: a later change is counted from there.
    """
    along = slice_along(library, base, effect)
    if along is None:
        return None
    space, own = library.space([effect.name]), slice(-len(effect.parameters), None)
    here = along.values
    prior = np.linalg.inv(space.covariance[own, own])
    covariance = np.linalg.inv(along.curved / temper + prior)
    step = covariance @ (along.slope / temper + prior @ (space.centre[own] - here))
    away = np.clip(here + step, space.low[own], space.high[own]) - here
    gain = float(along.slope @ away - 0.5 * away @ along.curved @ away) / temper
    return _as_control(library, effect.name, here + step, covariance, gain)


def _as_control(library: Library, name: str, at: Array, wide: Array, gain: float) -> Control:
    """Values and their covariance, with a gain that chance is counted into, by window."""
    return Control(name, at, wide, (max(gain, 0.0) + _BY_CHANCE) / len(library.likelihood.dof))
