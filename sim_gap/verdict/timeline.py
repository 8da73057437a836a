"""The gap window by window, before and after the explanation: what a time line is drawn from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.residuals import ratios
from steerd.sysid.inference.search import Point

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Timeline:
    """Whitened squared error per degree of freedom of each window; 1 is noise alone.

    Attributes:
        run: (W,) name of the drive.
        t0: (W,) where the window begins in its drive [s]; t1: where it ends.
        before: (W,) under the base.
        after: (W,) under the explanation.
    """

    run: tuple[str, ...]
    t0: Array
    t1: Array
    before: Array
    after: Array


def timeline_of(engine: Engine, before: Point, after: Point, names: Sequence[str]) -> Timeline:
    """The time line of two fits; `names` are those of the runs."""
    layout = engine.readings.layout
    return Timeline(
        tuple(names[r] for r in layout.run),
        layout.t.copy(),
        layout.t + layout.spans[:, 3] * layout.h,
        ratios(before),
        ratios(after),
    )
