"""A car fitted to healthy drives: car and noise in turn, under the errors of one second.

Errors are weighed by instruments and disturbances both, as a diagnosis weighs them, so that a
healthy car has no gap to it. The search begins under a discrepancy as large as the start is wrong.
Base parameters and the structure that every car has (tyres that level off, a bent linkage) are free
together under weak priors.
"""

# Why: docs/decisions/diagnosis.md#d52
# Why: docs/decisions/identification.md#d94

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.model import Model
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import thinned
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import AugmentedCar, make_augmented_car
from steerd.sysid.inference.hypotheses import explain
from steerd.sysid.inference.library import Library
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.noise import (
    Noise,
    calibrated,
    learn_noise,
    noise_of_sizes,
    noise_share,
    usual_noise,
)
from steerd.sysid.inference.predictor import Predictor, open_predictor
from steerd.sysid.inference.residuals import robust_mean
from steerd.sysid.inference.search import Point, minimise, open_point, stand, with_size
from steerd.sysid.inference.space import (
    informative_effects,
    make_space,
    nuisance_names,
    weak_knowledge,
)

ORDINARY: dict[str, float] = {
    "lf": 0.075, "lr": 0.1, "steer_gain": 0.33, "inertia_z": 0.4, "c_sf": 0.7, "c_sr": 0.7,
    "marker_offset.forward": 0.25, "accel_max": 0.2, "decel_max": 0.2,
    "lateral_load_transfer.k": 0.3,
}  # fmt: skip
"""Share of identification's weak priors that is left when a base is fitted. A car comes with a
wheelbase (the coordinate of `lf`) known to 15 mm, a centre of gravity known to 2 cm, markers placed
to 5 mm and a gain known to 0.1. A tyre's friction falls by a few tenths at most where its load
doubles, which makes `k` 0.15 on a car as low as these; a larger one stands in for tyres that slide,
and says too much of bends harder than the drives'."""
MEASURED = 5e-4  # share of a measured wheelbase: it stays within 0.1 mm of what was stated
_LOUDER, _LOUDEST = 3.0, 80.0  # noise grows by this factor, to so many times the usual, until ...
_FAR_OFF = 0.2  # ... a smaller share of the windows is bounded at the start
_STIFFER, _ENOUGH = 3.0, 30.0
"""Stiffness of a further start, and driving that is enough to choose between them [s]."""
_ROUNDS = 2  # how often noise and base are learnt in turn


class Step(NamedTuple):
    """An effect that drives show, and what the evidence gains by those that were found [nats]."""

    effect: str
    gain: float


class Stated(NamedTuple):
    """What whoever asks vouches for."""

    wheelbase: bool = False  # whether the model's axles stand at a measured distance
    held: tuple[str, ...] = ()  # parameters and effects that keep the model's values

    def holds(self, name: str) -> bool:
        """Whether a parameter (`name` or `effect.name`) keeps its value."""
        return name in self.held or name.partition(".")[0] in self.held


NOTHING = Stated()


@dataclass(frozen=True, eq=False)
class FittedCar:
    """A car at its best on healthy drives."""

    likelihood: Likelihood  # the windows under what was learnt to be random
    point: Point  # the car there
    noise: Noise  # how large what is random is
    nuisance: tuple[str, ...]  # names of the car's free parameters
    shares: Mapping[str, float]  # of identification's weak priors, by parameter (see `ORDINARY`)
    selected: tuple[Step, ...] = ()  # effects beyond every car's, the surest first

    @property
    def augmented(self) -> AugmentedCar:
        """The car that was fitted."""
        return self.likelihood.predictor.augmented


def fit_car(
    base: CarFile | Model[float],
    runs: Sequence[Run],
    stated: Stated = NOTHING,
    near: Array | None = None,
) -> FittedCar:
    """Fit car and noise in turn, then with the limits and the play that the drives show.

    Args:
        base: the car that weak priors are about.
        runs: drives without a gap.
        stated: what keeps the base's value.
        near: where the search starts, of `choose_start`; None for the base.

    Raises:
        FloatingPointError: the car's simulation diverges where the search starts.
        ValueError: no window sees enough poses.
    """
    fitted = _in_turn(_first(base, runs, stated, near), runs, _ROUNDS)
    shown = informative_effects(fitted.augmented, runs)
    free = {name.partition(".")[0] for name in fitted.nuisance if "." in name}
    effects = tuple(
        e for e in fitted.augmented.effects
        if e.in_base and e.name in shown and e.name not in free and not stated.holds(e.name)
        and not (e.same_as and set(e.same_as) <= set(fitted.nuisance))
    )  # fmt: skip
    library = Library(fitted.likelihood, fitted.nuisance, effects, known=False)
    found = explain(library, c.BUILT_IN, known=fitted.point)
    best = found.hypotheses[0]
    if not best.effects:
        return replace(fitted, point=best.point)
    gain = best.posterior.evidence - found.null.posterior.evidence
    steps = tuple(Step(name, gain) for name in best.effects)
    return replace(_with_effects(fitted, best.point, runs), selected=steps)


def choose_start(
    starts: Sequence[Model[float]], runs: Sequence[Run], stated: Stated = NOTHING
) -> tuple[Model[float], Array | None]:
    """The start from which these drives are explained best, and where its search ends (P,).

    Of one start nothing is asked. Of several, each is tried on stiffer tyres as well: from too soft
    ones, hard bends lead to softer ones still instead of to ones that level off.

    Raises:
        FloatingPointError: the simulation diverges at every one.
        ValueError: no window sees enough poses.
    """
    if len(starts) == 1:
        return starts[0], None
    some, found = thinned(runs, _ENOUGH), []
    models = [stiffer(start, factor, stated) for start in starts for factor in (1.0, _STIFFER)]
    for number, start in enumerate(models):
        try:
            end = _first(start, some, stated).point
            found.append((end.cost, number, end.parameters))
        except (FloatingPointError, np.linalg.LinAlgError):
            continue
    if not found:
        raise FloatingPointError("the simulation diverges at every start")
    _, number, near = min(found)
    return models[number], near


def stiffer(model: Model[float], factor: float, stated: Stated) -> Model[float]:
    """The model on tyres so many times as stiff, as far as nobody stated what they are."""
    car = model.car
    moved = {n: factor * getattr(car, n) for n in ("c_sf", "c_sr") if not stated.holds(n)}
    return model._replace(car=car._replace(**moved))


def _first(
    base: CarFile | Model[float], runs: Sequence[Run], stated: Stated, near: Array | None = None
) -> FittedCar:
    """The car at its best under noise as learnt about it, from noise that forgives the start.

    A window that is far off is bounded and pulls at nothing; were all so, the search would stay
    where it began.
    """
    base = replace(base, sd={}, sections={}) if isinstance(base, CarFile) else base
    augmented = make_augmented_car(base, runs)
    names = (*nuisance_names(augmented, runs), *structure_names(augmented, runs))
    nuisance = tuple(name for name in names if not stated.holds(name))
    shares = {**ORDINARY, **({"lf": MEASURED} if stated.wheelbase else {})}
    augmented = replace(augmented, knowledge=weak_knowledge(augmented, nuisance, shares))
    predictor, usual = open_predictor(augmented, runs), usual_noise(estimate_noise(runs))
    begin = partial(_begin, predictor, nuisance, near)
    noise, begun = usual, begin(usual)
    while begun[1].at.spun.mean() >= _FAR_OFF and noise.sizes[0] < _LOUDEST * usual.sizes[0]:
        noise = noise_of_sizes(_LOUDER * noise.sizes)
        begun = begin(noise)
    fitted = FittedCar(begun[0], minimise(*begun), noise, nuisance, shares)
    return fitted if noise is usual else _again(fitted, _learnt_noise(fitted))


def _begin(
    predictor: Predictor, nuisance: tuple[str, ...], near: Array | None, noise: Noise
) -> tuple[Likelihood, Point]:
    """Windows under a noise, and the car where its search begins: the base if not near another."""
    x, at = predictor.guess.copy(), predictor.augmented.base if near is None else near
    likelihood = make_likelihood(predictor, at, x, noise)
    space = make_space(predictor.augmented, nuisance)
    z = space.inside if near is None else space.chart.coordinates(near)
    return likelihood, open_point(likelihood, space, z, x)


def _again(fitted: FittedCar, noise: Noise) -> FittedCar:
    """The car at its best under another noise, its responses taken where the car is now."""
    predictor, old = fitted.likelihood.predictor, fitted.point
    likelihood = make_likelihood(predictor, old.parameters, old.x, noise)
    space = make_space(predictor.augmented, fitted.nuisance)
    z = np.clip(space.chart.coordinates(old.parameters), space.low, space.high)
    begun = stand(likelihood, space, z, old.x, max(old.size, c.SIZE_SMALL))
    return replace(fitted, likelihood=likelihood, point=minimise(likelihood, begun), noise=noise)


def _learnt_noise(fitted: FittedCar) -> Noise:
    """Noise given the car."""
    point = fitted.point
    return learn_noise(
        fitted.likelihood.predictor, point.parameters, point.x, point.linear, fitted.noise
    )


def _in_turn(fitted: FittedCar, runs: Sequence[Run], rounds: int) -> FittedCar:
    """Noise and car, each given the other, the noise at last as large as what drives leave."""
    for _ in range(rounds):
        fitted = _again(fitted, _learnt_noise(fitted))
    should = noise_share(fitted.likelihood.predictor, float(estimate_noise(runs)[2]))
    return _again(fitted, calibrated(fitted.noise, robust_mean(ratios(fitted)), should))


def ratios(fitted: FittedCar) -> Array:
    """(W,) whitened squared errors per degree of freedom, no discrepancy allowed."""
    return with_size(fitted.likelihood, fitted.point, 0.0).at.ratio


def structure_names(augmented: AugmentedCar, runs: Sequence[Run]) -> tuple[str, ...]:
    """Parameters of the effects that no real car is without, as far as such drives show them."""
    shown = informative_effects(augmented, runs)
    own = (e for e in augmented.effects if e.on_every_car and e.name in shown)
    return tuple(f"{effect.name}.{p.name}" for effect in own for p in effect.parameters)


def _with_effects(fitted: FittedCar, point: Point, runs: Sequence[Run]) -> FittedCar:
    """What was fitted, with the effects of a hypothesis free about its values."""
    old, start = fitted.augmented, point.parameters
    centre = old.base.copy()
    for name in point.space.effects:
        centre[old.places(name)] = start[old.places(name)]
    own = tuple(n for n in old.kernels.names if n.partition(".")[0] in point.space.effects)
    nuisance = (*fitted.nuisance, *own)
    augmented = replace(old, base=centre)
    augmented = replace(augmented, knowledge=weak_knowledge(augmented, nuisance, fitted.shares))
    predictor = replace(fitted.likelihood.predictor, augmented=augmented)
    likelihood = replace(fitted.likelihood, predictor=predictor)
    grown = replace(fitted, likelihood=likelihood, point=point, nuisance=nuisance)
    return _in_turn(grown, runs, 1)
