"""What the drives that a base was learnt from show of every effect.

They are the controls of every later diagnosis: a gap that an effect explains in a healthy car's
drives is the model's error, and it comes again in the next drives.
"""

# Why: docs/decisions/diagnosis.md#d121

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import BasePrior, Control
from steerd.sysid.inference.car_fit import FittedCar
from steerd.sysid.inference.hypotheses import begin
from steerd.sysid.inference.library import Library, linearise
from steerd.sysid.inference.posterior import design_effect
from steerd.sysid.inference.search import Point, minimise

Array = NDArray[np.float64]


def learn_controls(taught: FittedCar, known: BasePrior) -> tuple[Control, ...]:
    """The healthy drives diagnosed against the car that they taught, one Newton step an effect.

    Args:
        taught: the car.
        known: what a later diagnosis will know of it.

    Raises:
        FloatingPointError: the car's simulation diverges.
    """
    wider = replace(known, covariance=c.KNOWN_WIDER**2 * known.covariance)
    augmented = replace(taught.augmented, base=taught.point.parameters, knowledge=wider)
    predictor = replace(taught.likelihood.predictor, augmented=augmented)
    likelihood = replace(taught.likelihood, predictor=predictor)
    library = Library(likelihood, taught.nuisance, augmented.effects)
    base = minimise(likelihood, begin(library, (), (), taught.point.x))
    temper = design_effect(likelihood, base.size, controlled=True)
    found = (_control(library, base, effect, temper) for effect in augmented.effects)
    return tuple(control for control in found if control is not None)


def _control(library: Library, base: Point, effect: Effect, temper: float) -> Control | None:
    """Where an effect explains the drives best, to second order; no wider than its own prior."""
    found = linearise(library, base, effect)
    if found is None:  # no derivative shows it
        return None
    space, _, at = found
    rest, own = slice(0, -len(effect.parameters)), slice(-len(effect.parameters), None)
    h = np.tensordot(at.weight, at.h, 1)
    inner = h[rest, rest] + space.precision[rest, rest]
    curved = h[own, own] - h[own, rest] @ np.linalg.solve(inner, h[rest, own])
    null = np.array(library.likelihood.predictor.augmented.values(effect.name))
    prior = np.linalg.inv(space.covariance[own, own])
    covariance = np.linalg.inv(curved / temper + prior)
    step = covariance @ ((at.weight @ at.g)[own] / temper + prior @ (space.centre[own] - null))
    return Control(effect.name, np.clip(null + step, space.low[own], space.high[own]), covariance)
