"""Further starts; of drives at one speed, what differs between ends that explain them as well."""

# Why: docs/decisions/identification.md#d59

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from steerd.car_model.model import Model
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.excitation import SPEED_SPAN, measure_excitation
from steerd.sysid.inference.identifiability import ANOTHER_END, Estimate

COMPARABLE = 12.5
"""Ends whose log-likelihoods differ by less (5 standard deviations) explain drives as well."""
_REARWARD = 0.7
"""One candidate's centre of gravity lies closer to the rear axle by this factor."""
_LATER, _QUICKER = 0.02, 0.6
"""Another's servo waits so much longer [s], and then follows faster by this factor."""

START_SPREAD = 0.3
"""Further starts lie about the first with this relative standard deviation."""


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
