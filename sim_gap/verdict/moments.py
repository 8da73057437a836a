"""Moments that hold most of a gap: a place passed once, a bump, a second in which the car spun.

Held-out drives cannot confirm what shows in one of them alone, so no effect is named for it; when
and where it was is what a reader can look at, and drive again.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEW = 0.1
"""Share of the windows that are few."""
MOST = 0.5
"""Share of the excess error that is most of it."""
_LIKE = 0.2
"""What has more than this share of the worst window's excess belongs to it."""
_LISTED = 3
"""Moments that are listed."""
_NEAR = 2.5
"""Windows this near to each other are at one place [m]."""
_HUGE = 1e3
"""A window that spun counts no more than this often."""


def find_moments(ratios: Array) -> NDArray[np.int64]:
    """Windows, the worst first, that hold most of the excess though they are few; else none.

    Args:
        ratios: (W,) squared error of each window by what noise leaves.
    """
    excess = np.clip(ratios - 1.0, 0.0, _HUGE)
    order = np.argsort(-excess, kind="stable")
    worst: NDArray[np.int64] = order[excess[order] > _LIKE * excess.max(initial=0.0)]
    hold = float(excess[worst].sum()) >= MOST * float(excess.sum())
    return worst[: len(worst) if hold and len(worst) <= FEW * len(ratios) else 0]


def moments_words(ratios: Array, run: Sequence[str], t: Array, place: Array) -> str:
    """When and where most of the error is, in words; empty where it is spread out.

    Args:
        ratios: (W,) squared error of each window by what noise leaves.
        run: (W,) name of each window's drive.
        t: (W,) when each begins in its drive [s].
        place: (W, 2) where it does [m].
    """
    worst = find_moments(ratios)
    if not len(worst):
        return ""
    excess = np.clip(ratios - 1.0, 0.0, _HUGE)
    share = excess[worst].sum() / excess.sum()
    moments = [f"{run[w]} at {t[w]:.0f} s" for w in worst[:_LISTED]]
    more = ", …" if len(worst) > _LISTED else ""
    middle = place[worst].mean(axis=0)
    at_one = bool((np.linalg.norm(place[worst] - middle, axis=1) < _NEAR).all())
    where = f", near x {middle[0]:.1f} m, y {middle[1]:.1f} m" if at_one else ""
    count = f"{len(worst)} of {len(ratios)} windows"
    return f"{share:.0%} of it is in {count}: {', '.join(moments)}{more}{where}"
