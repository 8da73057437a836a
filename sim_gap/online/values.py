"""The car's numbers as learnt: values, standard deviations, and which the drive identifies."""

from typing import NamedTuple

import numpy as np

from steerd.car_model.effects import find_effect
from steerd.car_model.params import PARAMETERS
from steerd.sim_gap.online.learner import Known

INFORMED = 0.5
"""A number is identified by a drive that makes its standard deviation so many times smaller."""
SHARP = 0.03
"""Or that is known to this share of its bounds' half width, from before."""
_UNITS = {parameter.name: parameter.unit for parameter in PARAMETERS}


class Value(NamedTuple):
    """One number of the base.

    Attributes:
        name: `name`, or `effect.name` of an effect that the base has.
        value: the estimate, with its standard deviation `sd`; SI units.
        unit: of both.
        identifiable: whether the drive identifies it.
    """

    name: str
    value: float
    sd: float
    unit: str
    identifiable: bool


def values_of(known: Known) -> tuple[Value, ...]:
    """Every free number of the base."""
    space, track = known.anchor.space, known.track
    n = space.nuisance
    z = space.centre.copy()
    z[:n] += track.mean
    slopes = space.chart.slopes(z)[:, :n]
    parameters = space.chart.parameters(z)
    spread = np.sqrt(np.diag(slopes @ track.covariance @ slopes.T))
    before = np.sqrt(np.diag(slopes @ space.covariance[:n, :n] @ slopes.T))
    found = []
    for name in space.chart.free[:n]:
        place = space.chart.names.index(name)
        sd, width = float(spread[place]), space.chart.high[place] - space.chart.low[place]
        informed = sd < INFORMED * before[place] or sd < SHARP * 0.5 * width
        found.append(Value(name, float(parameters[place]), sd, unit_of(name), bool(informed)))
    return tuple(found)


def unit_of(name: str) -> str:
    """The unit of a parameter, or of an effect's (`effect.parameter`)."""
    effect, _, own = name.partition(".")
    if not own:
        return _UNITS[name]
    return next(p.unit for p in find_effect(effect).parameters if p.name == own)
