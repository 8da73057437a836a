"""A window's loss about a reference car, as a quadratic form in all that may have changed.

The reference is the car as it was learnt. The coordinates are the base's own and those of all
effects (`predictor`), so a window is evaluated once and never again.
"""

# Why: docs/decisions/diagnosis.md#d78

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import BaseSelection
from steerd.sim_gap.online.samples import WINDOW
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.augmented_car import AugmentedCar
from steerd.sysid.inference.likelihood import Reduced, make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.predictor import make_predictor
from steerd.sysid.inference.residuals import settled
from steerd.sysid.inference.search import stand
from steerd.sysid.inference.space import Space, informative_effects, make_space

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reference:
    """The car about which windows are seen.

    Attributes:
        augmented: base and library, the base's values those learnt.
        space: the base's coordinates first, then those of every effect that may have changed.
        noise: what is random.
    """

    augmented: AugmentedCar
    space: Space
    noise: Noise

    @property
    def late(self) -> float:
        """How late poses are [s]."""
        return float(self.augmented.base[self.augmented.kernels.names.index("pose_delay")])

    def places(self, effect: str) -> list[int]:
        """Coordinates of an effect."""
        free = self.space.chart.free
        return [i for i, name in enumerate(free) if name.startswith(f"{effect}.")]


@dataclass(frozen=True, eq=False)
class Loss:
    """A window seen.

    Attributes:
        t: when it began [s].
        square: whitened squared error about the reference, at its best start.
        dof: its degrees of freedom.
        g: (n,) pull on the coordinates (direction of steepest improvement).
        h: (n, n) information about them.
    """

    t: float
    square: float
    dof: int
    g: Array
    h: Array

    @property
    def ratio(self) -> float:
        """Whitened squared error per degree of freedom; 1 is noise."""
        return self.square / self.dof

    @property
    def weight(self) -> float:
        """What it counts: less where nothing explains it (Student's t)."""
        return 2.0 / (1.0 + self.ratio)


def may_change(augmented: AugmentedCar, runs: Sequence[Run]) -> tuple[str, ...]:
    """Effects that can come about while a car drives and show at once.

    Those that could be part of a car: what is a matter of a place or of the time of day is none
    that a window can show.
    """
    effects = {e.name: e for e in augmented.effects}
    return tuple(
        name
        for name in informative_effects(augmented, runs)
        if effects[name].selectable_in_base is not BaseSelection.NEVER
    )


def linearise(reference: Reference, run: Run, t: float) -> Loss | None:
    """See one window; None where the reference's simulation leaves the map.

    Args:
        reference: the car.
        run: the window.
        t: when it began [s].
    """
    try:
        predictor = make_predictor(reference.augmented, [run], WINDOW)
        fixed = make_space(reference.augmented, ())
        likelihood = make_likelihood(predictor, reference.noise)
        found = settled(likelihood, fixed, fixed.centre)
        point = stand(likelihood, reference.space, reference.space.centre, found.x, 0.0)
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None
    return window_losses(point.at, [t])[0]


def window_losses(at: Reduced, times: Sequence[float]) -> list[Loss]:
    """Windows from their losses.

    Args:
        at: the losses.
        times: when each window began [s].
    """
    return [
        Loss(t, float(at.square[w]), int(at.dof[w]), at.g[w], at.h[w]) for w, t in enumerate(times)
    ]
