"""Where on the floor windows are worse than elsewhere: discs to start a search for a patch from.

Kulldorff's spatial scan statistic (Communications in Statistics 26, 1997) with the normal model:
every disc about a window, of some radii, is compared with the rest of the floor.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RADII = (0.6, 1.0, 1.6, 2.5)
"""Of the discs that are tried [m]."""
DISCS = 4
"""Discs that are returned at most."""
_FEWEST = 2
"""Windows in a disc at least; one alone may have been spun by anything."""


def suspicious_discs(where: Array, badness: Array) -> list[tuple[float, float, float]]:
    """Discs whose windows are worse than the others, the most significant first.

    Given are the windows' places (W, 2) [m], and the squared error of each by what noise leaves;
    found are centre and radius [m]. No disc's centre lies within another, and none is found where
    no disc of at least two windows is worse than the rest.
    """
    if not len(where):
        return []
    distance = np.linalg.norm(where[:, None] - where[None, :], axis=2)
    level = np.log1p(badness)  # a window that spun is bad, and not a thousand times as bad
    away = level - level.mean()
    inside = np.stack([distance < radius for radius in RADII])
    count = inside.sum(axis=2)
    excess = inside @ away
    share = count / len(where)
    proper = (count >= _FEWEST) & (share <= 0.5) & (excess > 0.0)
    score = np.where(proper, excess**2 / np.maximum(count * (1.0 - share), 1e-9), 0.0)
    score = score.round(9)  # discs of the same windows are alike; the first, smallest one is taken
    found: list[tuple[float, float, float]] = []
    for place in np.argsort(-score, axis=None, kind="stable"):
        r, w = np.unravel_index(place, score.shape)
        if score[r, w] <= 0.0 or len(found) == DISCS:
            break
        (x, y), radius = where[w], RADII[int(r)]
        if all(np.hypot(x - a, y - b) > max(radius, other) for a, b, other in found):
            found.append((float(x), float(y), radius))
    return found
