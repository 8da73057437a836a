"""A car taught by windows that know disturbances, where whole drives leave more than noise.

`fit` weighs errors as instruments' noise. Where they are many times that, the model misses
something or the car is pushed about, and its values follow what was missed. A teacher, from the
room that knows disturbances, then gives the values; it is handed in, so that no layer points
upwards.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import parameter_vector
from steerd.car_model.params import PARAMETERS, Car
from steerd.sysid.data.dataset import Run
from steerd.sysid.estimation.chart import make_chart
from steerd.sysid.estimation.fit import Fit
from steerd.sysid.estimation.identifiability import is_identifiable, manoeuvre_for, standard_errors
from steerd.sysid.estimation.outcome import Row, Step


class TaughtModel(NamedTuple):
    """A car and what is known of it.

    Attributes:
        model: the car with the effects that the drives show.
        sd: standard errors of what was free, by `parameter` or `effect.parameter`.
        sections: tables for the car file beside its numbers, by name.
        selected: effects that were looked for and found, those that every car has aside.
        notes: what a person should know.
    """

    model: Model[float]
    sd: Mapping[str, float]
    sections: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
    selected: tuple[Step, ...] = ()
    notes: tuple[str, ...] = ()


class Stated(NamedTuple):
    """What whoever asks vouches for.

    Attributes:
        wheelbase: whether the model's axles stand at a measured distance.
        held: parameters and effects that keep the model's values.
    """

    wheelbase: bool = False
    held: tuple[str, ...] = ()

    def holds(self, name: str) -> bool:
        """Whether a parameter (`name` or `effect.name`) keeps its value."""
        return name in self.held or name.partition(".")[0] in self.held


NOTHING = Stated()

Teacher = Callable[[Sequence[Model[float]], Sequence[Run], Stated], TaughtModel]
"""Teaches a car from parts of drives, from the best of some starts, within what is stated.

Raises ValueError or FloatingPointError where the drives are not fit for it."""


def start_of(model: Model[float], found: Fit) -> Model[float]:
    """Where teaching starts: the car as given, with what the fit identified."""
    known = {n: e.value for n, e in found.estimates.items() if e.identifiable and "." not in n}
    return model._replace(car=model.car._replace(**known))


def taught_rows(given: Car[float], taught: TaughtModel) -> tuple[dict[str, Row], dict[str, Row]]:
    """A row for each parameter of the car, and for each of its effects."""
    known = _identifiable(taught)
    rows = {}
    for p in PARAMETERS:
        value, free = float(getattr(taught.model.car, p.name)), p.name in taught.sd
        rows[p.name] = _row(p.name, (value, float(getattr(given, p.name)), p.unit), taught, known)
        if not free:
            rows[p.name] = rows[p.name]._replace(sd=None, free=False, identifiable=False)
    effects = {
        f"{e.name}.{p.name}": _row(f"{e.name}.{p.name}", (value, p.null, p.unit), taught, known)
        for e, values in zip(taught.model.effects, taught.model.values, strict=True)
        for p, value in zip(EFFECTS[e.name].parameters, values, strict=True)
        if f"{e.name}.{p.name}" in taught.sd
    }
    return rows, effects


def _row(
    name: str,
    numbers: tuple[float, float, str],
    taught: TaughtModel,
    known: Mapping[str, bool],
) -> Row:
    value, before, unit = numbers
    sure = known.get(name, False)
    moved = "marker_offset.forward" in taught.sd
    hint = "" if sure or name not in taught.sd else manoeuvre_for(name, moved)
    return Row(value, before, taught.sd.get(name), unit, True, sure, hint)


def _identifiable(taught: TaughtModel) -> dict[str, bool]:
    """Whether each free parameter is known far better than before any drive."""
    model, vector = taught.model, parameter_vector(taught.model)
    own = {f"{e.name}.{p.name}" for e in model.effects for p in e.parameters}
    free = [name for name in taught.sd if name in Car._fields or name in own]
    chart = make_chart(model.effects, vector, free)
    z = chart.coordinates(vector)
    priors = standard_errors(chart, z, np.diag(chart.spread**2))
    return {
        name: is_identifiable(name, float(vector[i]), taught.sd[name], float(priors[i]))
        for name, i in ((name, chart.names.index(name)) for name in free)
    }
