"""What may be a hypothesis, and where one is beside another."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from steerd.car_model.effect import Effect
from steerd.car_model.params import Car
from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference.augmented_car import AugmentedCar, Control
from steerd.sysid.inference.chart import places_of
from steerd.sysid.inference.likelihood import Likelihood, Reduced
from steerd.sysid.inference.posterior import design_effect
from steerd.sysid.inference.search import Point
from steerd.sysid.inference.space import Space, make_space


@dataclass(frozen=True, eq=False)
class Library:
    """What may be a hypothesis."""

    likelihood: Likelihood  # the windows
    nuisance: tuple[str, ...]  # the base's free parameters
    effects: tuple[Effect, ...]  # what may be added to it
    # Whether the base's prior is knowledge from other drives, which windows whose errors repeat
    # outweigh no sooner than as many independent ones as they are worth
    known: bool = True

    def space(self, names: Sequence[str]) -> Space:
        """Coordinates of a hypothesis: the base's, then its effects'."""
        augmented = self.likelihood.predictor.augmented
        gone = {same for e in augmented.effects if e.name in names for same in e.same_as}
        kept = [name for name in self.nuisance if name not in gone]
        return make_space(augmented, kept, names).heavier(self.worth)

    @cached_property
    def worth(self) -> float:
        """How many windows are worth one where nothing is left but noise."""
        return self.design_effect(0.0) if self.known else 1.0

    @cached_property
    def controls(self) -> dict[str, Control]:
        """What healthy drives show of effects, by name."""
        known = self.likelihood.predictor.augmented.knowledge
        return {} if known is None else {one.effect: one for one in known.controls}

    def design_effect(self, size: float) -> float:
        """How many windows are worth one under a discrepancy of this size."""
        return design_effect(self.likelihood, size, bool(self.controls))

    def effect(self, name: str) -> Effect:
        """An effect by name."""
        return next(e for e in self.likelihood.predictor.augmented.effects if e.name == name)


def carry(likelihood: Likelihood, space: Space, point: Point, own: Point | None = None) -> Array:
    """A point's values in another hypothesis' coordinates; what it lacks is as in `own`.

    What is the base's parameter in one and an effect in the other (`same_as`) keeps its amount.
    """
    known = dict(zip(space.chart.free, space.centre.tolist(), strict=True))
    for each in filter(None, (own, point)):
        known |= dict(zip(each.space.chart.free, each.z.tolist(), strict=True))
    z = np.array([known[name] for name in space.chart.free])
    augmented = likelihood.predictor.augmented
    amounts = augmented.folded(point.parameters)
    for effect in (e for e in augmented.effects if e.same_as):
        if effect.name in point.space.effects and effect.name not in space.effects:
            parameters = space.chart.parameters(z)
            for name in effect.same_as:
                parameters[space.chart.names.index(name)] = getattr(amounts, name)
            z = space.chart.coordinates(parameters)
        elif effect.name in space.effects and effect.name not in (own or point).space.effects:
            z = _as_effect(augmented, space, z, effect, amounts)
    return np.asarray(np.clip(z, space.low, space.high))


def _as_effect(
    augmented: AugmentedCar, space: Space, z: Array, effect: Effect, amounts: Car[float]
) -> Array:
    """Coordinates in which an effect, where it is linear, holds what the base had moved."""
    more, name = z.copy(), effect.same_as[0]
    more[places_of(space.chart.free, effect.name)[0]] += effect.parameters[0].scale
    cars = (augmented.folded(space.chart.parameters(each)) for each in (z, more))
    now, then = (getattr(car, name) for car in cars)
    return z + (more - z) * (getattr(amounts, name) - now) / (then - now) if then != now else z


def linearise(
    library: Library, start: Point, effect: Effect
) -> tuple[Space, Array, Reduced] | None:
    """A hypothesis with an effect more, the car as it is: coordinates and losses there.

    Its derivatives are finite differences. None where they vanish at the null, or diverge.
    """
    if effect.zero_gradient:
        return None
    space = library.space([*start.space.effects, effect.name])
    likelihood, z, columns = library.likelihood, carry(library.likelihood, space, start), []
    own = range(len(z) - len(effect.parameters), len(z))
    here, parameters = start.linear.error, space.chart.parameters(z)
    # Beyond the effect's bounds, or by a payload, `z` does not hold what the base had moved.
    if not np.array_equal(parameters, start.parameters):
        here, _ = likelihood.predictor.errors(parameters, start.x)
    keep = np.array([start.space.chart.free.index(n) for n in space.chart.free[: own.start]], int)
    for i, parameter in zip(own, effect.parameters, strict=True):
        step = 0.1 * parameter.scale
        moved = z.copy()
        moved[i] += step if z[i] + step <= space.high[i] else -step
        error, finite = likelihood.predictor.errors(space.chart.parameters(moved), start.x)
        if not finite:
            return None
        columns.append((here - error) / (moved[i] - z[i]))
    by_own = likelihood.rotation @ np.stack(columns, axis=2)
    by_z = np.concatenate([start.rotated.by_z[:, :, keep], by_own], axis=2)
    rotated = start.rotated._replace(by_z=by_z)
    view = likelihood.weigh(rotated, start.size)
    return space, z, likelihood.reduce(view, start.linear.error, start.x)


class Slice(NamedTuple):
    """The cost as a function of one effect's parameters alone, the base at its best beside each.

    From `values` it falls by `slope' d - d' curved d / 2` over a distance `d` [nats].
    """

    values: Array
    slope: Array
    curved: Array


def slice_along(library: Library, start: Point, effect: Effect) -> Slice | None:
    """The cost along an effect that a hypothesis lacks, its own prior left out.

    To second order about the hypothesis' optimum, where nothing else pulls. None where no
    derivative shows it.
    """
    found = linearise(library, start, effect)
    if found is None:
        return None
    space, z, at = found
    rest, own = slice(0, -len(effect.parameters)), slice(-len(effect.parameters), None)
    h = np.tensordot(at.weight, at.h, 1)
    inner = h[rest, rest] + space.precision[rest, rest]
    curved = h[own, own] - h[own, rest] @ np.linalg.solve(inner, h[rest, own])
    return Slice(z[own], (at.weight @ at.g)[own], curved)
