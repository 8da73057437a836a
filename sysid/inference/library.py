"""What may be a hypothesis, and where one is beside another."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Effect
from steerd.sysid.inference.augmented_car import Control
from steerd.sysid.inference.likelihood import Likelihood, Reduced
from steerd.sysid.inference.posterior import design_effect
from steerd.sysid.inference.search import Point
from steerd.sysid.inference.space import Space, make_space

Array = NDArray[np.float64]


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


def carry(space: Space, point: Point, own: Point | None = None) -> Array:
    """A point's values in another hypothesis' coordinates; what it lacks is as in `own`."""
    known = dict(zip(space.chart.free, space.centre.tolist(), strict=True))
    if own is not None:
        known |= dict(zip(own.space.chart.free, own.z.tolist(), strict=True))
    known |= dict(zip(point.space.chart.free, point.z.tolist(), strict=True))
    z = np.array([known[name] for name in space.chart.free])
    return np.asarray(np.clip(z, space.low, space.high))


def linearise(
    library: Library, start: Point, effect: Effect
) -> tuple[Space, Array, Reduced] | None:
    """A hypothesis with an effect more, at that effect's null: coordinates and losses there.

    Its derivatives are finite differences. None where they vanish at the null, or diverge.
    """
    if effect.zero_gradient:
        return None
    space = library.space([*start.space.effects, effect.name])
    likelihood, z, columns = library.likelihood, carry(space, start), []
    own = range(len(z) - len(effect.parameters), len(z))
    # The base's parameter that the effect replaces is back at its prior in `z`, not in the start.
    here, _ = likelihood.predictor.errors(space.chart.parameters(z), start.x)
    keep = np.array([start.space.chart.free.index(name) for name in space.chart.free[: own.start]])
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

    From the effect's null it falls by `slope' d - d' curved d / 2` over a distance `d` [nats].
    """

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
    space, _, at = found
    rest, own = slice(0, -len(effect.parameters)), slice(-len(effect.parameters), None)
    h = np.tensordot(at.weight, at.h, 1)
    inner = h[rest, rest] + space.precision[rest, rest]
    curved = h[own, own] - h[own, rest] @ np.linalg.solve(inner, h[rest, own])
    return Slice((at.weight @ at.g)[own], curved)
