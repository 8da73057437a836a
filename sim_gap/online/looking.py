"""One window seen from an anchor: how its loss changes with every parameter that may have changed.

The anchor is the car as it was learnt. About it each window is a quadratic form in the base's own
coordinates and those of all effects (`engine`), so a window is evaluated once and never again.
"""

# Why: docs/decisions/diagnosis.md#d78

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import BaseSelection
from steerd.sim_gap.online.samples import WINDOW
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.engine import open_engine
from steerd.sysid.inference.likelihood import Reduced, make_likelihood
from steerd.sysid.inference.noise import Noise
from steerd.sysid.inference.residuals import settled
from steerd.sysid.inference.search import stand
from steerd.sysid.inference.space import Space, informative_effects, make_space
from steerd.sysid.inference.superset import Superset

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Anchor:
    """The car about which windows are seen."""

    superset: Superset  # base and library, the base's values those learnt
    space: Space  # the base's coordinates first, then those of every effect that may have changed
    noise: Noise  # what is random

    @property
    def late(self) -> float:
        """How late poses are [s]."""
        return float(self.superset.base[self.superset.kernels.names.index("pose_delay")])

    def places(self, effect: str) -> list[int]:
        """Coordinates of an effect."""
        free = self.space.chart.free
        return [i for i, name in enumerate(free) if name.startswith(f"{effect}.")]


@dataclass(frozen=True, eq=False)
class Look:
    """A window seen."""

    t: float  # when it began [s]
    square: float  # whitened squared error about the anchor, at its best start
    dof: int  # its degrees of freedom
    g: Array  # (n,) pull on the coordinates (direction of steepest improvement)
    h: Array  # (n, n) information about them

    @property
    def ratio(self) -> float:
        """Whitened squared error per degree of freedom; 1 is noise."""
        return self.square / self.dof

    @property
    def weight(self) -> float:
        """What it counts: less where nothing explains it (Student's t)."""
        return 2.0 / (1.0 + self.ratio)


def may_change(superset: Superset, runs: Sequence[Run]) -> tuple[str, ...]:
    """Effects that can come about while a car drives and show at once.

    Those that could be part of a car: what is a matter of a place or of the time of day is none
    that a window can show.
    """
    effects = {e.name: e for e in superset.effects}
    return tuple(
        name
        for name in informative_effects(superset, runs)
        if effects[name].selectable_in_base is not BaseSelection.NEVER
    )


def look(anchor: Anchor, run: Run, t: float) -> Look | None:
    """See one window; None where the anchor's simulation leaves the map.

    Args:
        anchor: the car.
        run: the window.
        t: when it began [s].
    """
    try:
        engine = open_engine(anchor.superset, [run], WINDOW)
        fixed = make_space(anchor.superset, ())
        guess = engine.guess.copy()
        likelihood = make_likelihood(engine, anchor.superset.base, guess, anchor.noise)
        found = settled(likelihood, fixed, fixed.centre)
        point = stand(likelihood, anchor.space, anchor.space.centre, found.x, 0.0)
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None
    return looks_of(point.at, [t])[0]


def looks_of(at: Reduced, times: Sequence[float]) -> list[Look]:
    """Windows from their losses.

    Args:
        at: the losses.
        times: when each window began [s].
    """
    return [
        Look(t, float(at.square[w]), int(at.dof[w]), at.g[w], at.h[w]) for w, t in enumerate(times)
    ]
