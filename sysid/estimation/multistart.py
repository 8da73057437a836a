"""Drives at one speed: other starts, and what differs between ends that explain them as well."""

# Why: docs/decisions/identification.md#d59

from collections.abc import Sequence
from dataclasses import replace

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
