"""What healthy drives teach about a base car, beyond its values: how sure, and where it fails.

Two things travel from `identify` to `diagnose`, in the file beside the car file. The joint
covariance of the base's coordinates: lengths, gains and inertia move together, and an effect must
not be named for what the base's own uncertainty covers. And the model discrepancy: by how much
errors exceed the noise where the car corners hard (Kennedy and O'Hagan, 2001, as a variance by
regime), so that a base that is not good enough there cannot accuse.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EDGES: tuple[float, ...] = (1.0, 2.0, 3.0, 4.5, 6.0)
"""Bins of the windows' mean lateral acceleration [m/s^2]; the last is open."""
WINDOWS_MIN = 4
"""A bin with fewer windows says nothing of its own."""
EXCESS_MAX = 25.0
"""No regime is trusted less than this."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of a base.

    Attributes:
        names: of the base's free parameters, in the order of the coordinates (see `chart`).
        covariance: (n, n) of the coordinates.
        excess: (len(EDGES) + 1,) squared error over noise by lateral acceleration, 1 or more.
        values: the parameters' values that the covariance lies about, empty: the base's own.
    """

    names: tuple[str, ...]
    covariance: Array
    excess: tuple[float, ...] = (1.0,) * (len(EDGES) + 1)
    values: tuple[float, ...] = ()

    def part(self, names: Sequence[str]) -> Array:
        """Covariance of some of the coordinates, in this order.

        Raises:
            KeyError: one is not among `names`.
        """
        places = [self.names.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(places, places)])


class Spread(NamedTuple):
    """How much scores really vary.

    Attributes:
        scores: sum of their squares (n, n) over pieces of driving.
        pieces: how many there are.
    """

    scores: Array
    pieces: float


def inflate_each(covariance: Array, spread: Spread) -> Array:
    """The covariance with each coordinate as wide as its own scores make it, correlations kept.

    This is the sandwich of White (1982), coordinate by coordinate, never narrower than before: with
    about as many coordinates as pieces no direction is separated from chance, but a single
    coordinate's standard error is known from p pieces to one part in sqrt(2 p).
    """
    pieces = max(spread.pieces, 2.0)
    scores = spread.scores * pieces / (pieces - 1.0)
    robust = np.einsum("ij,jk,ik->i", covariance, scores, covariance)
    wider = np.sqrt(np.maximum(robust / np.diag(covariance), 1.0))
    each: Array = covariance * np.outer(wider, wider)
    return each


def excess_by_regime(ratio: Array, lateral: Array) -> tuple[float, ...]:
    """How much larger than noise errors are, by lateral acceleration; it never falls.

    Args:
        ratio: (W,) whitened squared error per degree of freedom of healthy windows; 1 is noise.
        lateral: (W,) mean lateral acceleration of each [m/s^2].
    """
    place = np.digitize(lateral, EDGES)
    count = np.bincount(place, minlength=len(EDGES) + 1)
    hardest = max(np.flatnonzero(count >= WINDOWS_MIN), default=0)
    found, level = [], 1.0
    for regime in range(len(EDGES) + 1):
        mine = ratio[place == regime]
        if len(mine) >= WINDOWS_MIN:
            level = max(level, float(np.expm1(np.log1p(np.minimum(mine, 1e6)).mean())))
        elif regime > hardest:
            # Nobody drove so: what the model leaves grows at least with the square of the force.
            low = EDGES[regime - 1]
            level *= (EDGES[regime] / low) ** 2 if regime < len(EDGES) else 2.0
        found.append(min(level, EXCESS_MAX))
    return tuple(found)


def knowledge_section(known: Knowledge) -> dict[str, Any]:
    """The table `knowledge` of the file beside a car file: names, deviations, correlations."""
    sd = np.sqrt(np.diag(known.covariance))
    correlation = known.covariance / np.outer(sd, sd)
    rows = [[round(float(c), 6) for c in row[: i + 1]] for i, row in enumerate(correlation)]
    return {
        "names": list(known.names),
        "sd": [float(f"{v:.6g}") for v in sd],
        "correlation": rows,
        "excess": [round(v, 3) for v in known.excess],
        "values": [float(f"{v:.9g}") for v in known.values],
    }


def knowledge_of_section(table: Mapping[str, Any]) -> Knowledge | None:
    """Knowledge from the table that `knowledge_section` makes, None if it is empty.

    Raises:
        ValueError: the table is no covariance.
    """
    if not table:
        return None
    try:
        names = tuple(str(name) for name in table["names"])
        sd = np.array(table["sd"], float)
        rows = table["correlation"]
        correlation = np.zeros((len(names),) * 2)
        for i, row in enumerate(rows):
            correlation[i, : i + 1] = row
        excess = tuple(float(v) for v in table["excess"])
        values = tuple(float(v) for v in table["values"])
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"[knowledge] is not what identify writes ({error})") from error
    correlation += np.tril(correlation, -1).T
    shaped = len(rows) == len(sd) == len(values) == len(names) and len(excess) == len(EDGES) + 1
    if not (shaped and np.isfinite(correlation).all() and (sd > 0.0).all()):
        raise ValueError("[knowledge] is not what identify writes")
    # Rounding may leave a tiny negative eigenvalue; a covariance has none.
    spectrum, axes = np.linalg.eigh(correlation)
    correlation = (axes * np.maximum(spectrum, 1e-8)) @ axes.T
    return Knowledge(names, correlation * np.outer(sd, sd), excess, values)
