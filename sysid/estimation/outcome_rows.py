"""Rows of an outcome: each parameter before and after, and how well it is known."""

from collections.abc import Sequence
from math import isnan

import numpy as np

from steerd.car_model.model import Model
from steerd.car_model.params import PARAMETERS, Car
from steerd.sysid.data.dataset import Run
from steerd.sysid.estimation.fit import Fit
from steerd.sysid.estimation.identifiability import MANOEUVRES, RELATIVE_MAX
from steerd.sysid.estimation.outcome import Row
from steerd.sysid.estimation.prediction_horizon import restore_end_stops
from steerd.sysid.paper.search_history import NAMES, SearchHistory


def make_rows(
    start: Car[float],
    given: Car[float],
    runs: Sequence[Run],
    found: Fit | None,
    searches: Sequence[SearchHistory],
) -> tuple[Car[float], dict[str, Row]]:
    """The identified car and a row for each of its parameters.

    Args:
        start: the car that was fitted, its end stops moved out of the way.
        given: the car as whoever asks gave it.
        runs: the fitted drives.
        found: our fit, or None.
        searches: those of the paper's methods, or none.
    """
    known = _estimated(found, searches)
    values = {name: each[0] for name, each in known.items() if name in Car._fields}
    car = start._replace(**values)
    if start.steer_max != given.steer_max:
        car = restore_end_stops(car, given, runs)
    rows = {}
    for p in PARAMETERS:
        before, value = float(getattr(given, p.name)), float(getattr(car, p.name))
        sd, identifiable, hint = known[p.name][1:] if p.name in known else (None, False, "")
        rows[p.name] = Row(value, before, sd, p.unit, p.name in known, identifiable, hint)
    return car, rows


def make_effect_rows(model: Model[float], found: Fit | None) -> dict[str, Row]:
    """A row for each free parameter of the car file's effects."""
    pairs = ((e, p) for e in model.effects for p in e.parameters)
    before = [value for values in model.values for value in values]
    rows = {}
    for (effect, p), start in zip(pairs, before, strict=True):
        name = f"{effect.name}.{p.name}"
        if found is not None and name in found.estimates:
            e = found.estimates[name]
            rows[name] = Row(e.value, start, e.sd, p.unit, True, e.identifiable, e.manoeuvre)
    return rows


def _estimated(
    found: Fit | None, searches: Sequence[SearchHistory]
) -> dict[str, tuple[float, float | None, bool, str]]:
    """Value, standard error, identifiable and manoeuvre of every free parameter.

    A search has no standard error; the spread over its starts stands for it.
    """
    if found is not None:
        return {
            name: (e.value, e.sd, e.identifiable, e.manoeuvre)
            for name, e in found.estimates.items()
        }
    best = _best(searches).final
    finals = np.array([search.final for search in searches if not search.diverged])
    spread = finals.std(axis=0, ddof=1) if len(finals) > 1 else np.full(len(NAMES), np.nan)
    out: dict[str, tuple[float, float | None, bool, str]] = {}
    for name, value, sd in zip(NAMES, best.tolist(), spread.tolist(), strict=True):
        known = sd < RELATIVE_MAX * value
        out[name] = (value, None if isnan(sd) else sd, known, "" if known else MANOEUVRES[name])
    return out


def _best(searches: Sequence[SearchHistory]) -> SearchHistory:
    sound = [search for search in searches if not search.diverged]
    return min(sound, key=lambda search: float(search.losses[-20:].mean()))
