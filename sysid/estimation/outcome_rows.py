"""Rows of an outcome: each parameter before and after, and how well it is known."""

from collections.abc import Mapping, Sequence
from math import nan

import numpy as np

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import PARAMETERS, Car
from steerd.sysid.estimation.outcome import Row
from steerd.sysid.inference.identifiability import MANOEUVRES, RELATIVE_MAX, Estimate
from steerd.sysid.paper.search_history import NAMES, SearchHistory


def make_rows(
    given: Car[float], after: Car[float], known: Mapping[str, Estimate]
) -> dict[str, Row]:
    """A row for each parameter of the car; what is not among the estimates was not free."""
    return {
        p.name: _row(getattr(after, p.name), getattr(given, p.name), p.unit, known.get(p.name))
        for p in PARAMETERS
    }


def make_effect_rows(
    start: Model[float], after: Model[float], known: Mapping[str, Estimate]
) -> dict[str, Row]:
    """A row for each free parameter of the effects that the car came out with."""
    before = {
        f"{e.name}.{p.name}": value
        for e, values in zip(start.effects, start.values, strict=True)
        for p, value in zip(e.parameters, values, strict=True)
    }
    rows = {}
    for effect in after.effects:
        for p in EFFECTS[effect.name].parameters:
            name = f"{effect.name}.{p.name}"
            if name in known:
                found = known[name]
                rows[name] = _row(found.value, before.get(name, p.null), p.unit, found)
    return rows


def _row(value: float, before: float, unit: str, found: Estimate | None) -> Row:
    if found is None:
        return Row(float(value), float(before), None, unit, False, False)
    sd = None if np.isnan(found.sd) else found.sd
    return Row(float(value), float(before), sd, unit, True, found.identifiable, found.manoeuvre)


def searched_estimates(searches: Sequence[SearchHistory]) -> dict[str, Estimate]:
    """What the searches of the paper's methods found.

    A search has no standard error; the spread over its starts stands for it.
    """
    sound = [search for search in searches if not search.diverged]
    best = min(sound, key=lambda search: float(search.losses[-20:].mean())).final
    finals = np.array([search.final for search in sound])
    spread = finals.std(axis=0, ddof=1) if len(finals) > 1 else np.full(len(NAMES), nan)
    out = {}
    for name, value, sd in zip(NAMES, best.tolist(), spread.tolist(), strict=True):
        known = sd < RELATIVE_MAX * value
        out[name] = Estimate(value, sd, nan, known, "" if known else MANOEUVRES[name])
    return out
