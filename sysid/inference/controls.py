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
from steerd.sysid.inference.library import Library, slice_along
from steerd.sysid.inference.posterior import design_effect
from steerd.sysid.inference.search import Point, minimise

Array = NDArray[np.float64]

_BY_CHANCE = 1.0
"""What an effect of two parameters gains by chance [nats]."""


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
    """Where an effect explains the drives best; no wider than its own prior."""
    along = slice_along(library, base, effect)
    if along is None:
        return None
    space, own = library.space([effect.name]), slice(-len(effect.parameters), None)
    null = np.array(library.likelihood.predictor.augmented.values(effect.name))
    prior = np.linalg.inv(space.covariance[own, own])
    covariance = np.linalg.inv(along.curved / temper + prior)
    step = covariance @ (along.slope / temper + prior @ (space.centre[own] - null))
    values = np.clip(null + step, space.low[own], space.high[own])
    away = values - null
    gain = float(along.slope @ away - 0.5 * away @ along.curved @ away) / temper
    per_window = (max(gain, 0.0) + _BY_CHANCE) / len(base.at.dof)
    return Control(effect.name, values, covariance, per_window)
