"""Standard errors that stay true where the model, or a log's times, are not.

Two things make the errors of a fit larger than the noise alone would: residuals that are correlated
(what the model leaves out), and times that are in no log (the wire, a controller's own tick). The
first show in the fit's scores: their spread, neighbours included, is compared with what independent
noise would give (the heteroskedasticity and autocorrelation consistent estimate of Newey and West,
1987), and errors are inflated where chance does not explain it, never narrowed. The second are not
estimated; their effect on the estimates is linear (the "consider" parameters of Schmidt, 1966).
"""

# Why: docs/decisions/identification.md#d39

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.sysid.data.windows import Layout
from steerd.sysid.estimation.chart import make_chart
from steerd.sysid.estimation.objective import (
    COLUMN_STATES,
    STATES,
    Evaluation,
    Normal,
    Problem,
    information,
    normal_equations,
)

Array = NDArray[np.float64]
Doubts = Sequence[tuple[str, float]]
"""Parameters and by how much each may be off, whatever the fit says (standard deviations)."""

BIN = 0.05
"""Scores are gathered over this time [s]."""
CORRELATED = 1.0
"""Residuals are correlated for no longer [s]."""


def row_times(layout: Layout) -> Array:
    """Time of each measured number since its window's start (R,) [s]."""
    t = np.empty(len(layout.values))
    seen = layout.seen
    t[seen.row] = seen.t
    poses = seen.kind == 0
    for k in (1, 2):
        t[seen.row[poses] + k] = seen.t[poses]
    return t


def _scores(problem: Problem, at: Evaluation, normal: Normal, limit: float) -> list[Array]:
    """Each window's scores (bins, n): what its measurements say about the coordinates over time.

    What initial states can explain is taken out.
    """
    n, layout = len(at.prior_z), problem.layout
    inner = np.linalg.solve(normal.d, normal.b.transpose(0, 2, 1))[:, COLUMN_STATES]
    pull = np.clip(at.error, -limit, limit)
    place = np.maximum((row_times(layout) / BIN).astype(np.int64), 0)
    found = []
    for w, (a, b) in enumerate(zip(layout.bounds[:-1], layout.bounds[1:], strict=True)):
        slopes = at.slopes[a:b, :n] - at.slopes[a:b, n : n + STATES] @ inner[w]
        scores = np.zeros((int(place[a:b].max()) + 1, n))
        np.add.at(scores, place[a:b], slopes * pull[a:b, None])
        found.append(scores)
    return found


class Spread(NamedTuple):
    """How much the scores really vary.

    Attributes:
        scores: their covariance (n, n), neighbours up to `CORRELATED` apart included.
        pieces: about how many independent pieces of driving stand behind it.
    """

    scores: Array
    pieces: float


def score_spread(problem: Problem, at: Evaluation, normal: Normal, limit: float) -> Spread:
    """Covariance of the scores, with Bartlett's weights for neighbours."""
    windows = _scores(problem, at, normal, limit)
    most = round(CORRELATED / BIN)
    total = np.zeros((len(at.prior_z),) * 2)
    for scores in windows:
        total += scores.T @ scores
        for lag in range(1, min(most, len(scores) - 1) + 1):
            pair = scores[lag:].T @ scores[:-lag]
            total += (1.0 - lag / (most + 1.0)) * (pair + pair.T)
    rows = len(at.error)
    freedom = rows - len(at.prior_z) - STATES * len(windows)
    # equivalent degrees of freedom of Bartlett's window
    pieces = 1.5 * sum(map(len, windows)) / most
    return Spread(total * rows / max(freedom, 1), pieces)


def inflate(covariance: Array, spread: Spread) -> Array:
    """The covariance, wider in the directions in which the scores vary more than noise makes them.

    Among n directions, p pieces of mere noise would show one by a factor of (1 + sqrt(n / p))^2
    (Marchenko and Pastur, 1967): less than that is chance and widens nothing.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    factor, axes = np.linalg.eigh(root @ spread.scores @ root)
    chance = (1.0 + np.sqrt(len(values) / max(spread.pieces, 1.0))) ** 2
    factor = np.where(factor > chance, factor, 1.0)
    wider: Array = root @ (axes * factor) @ axes.T @ root
    return wider


def inflate_each(covariance: Array, spread: Spread) -> Array:
    """The covariance with each coordinate as wide as its own scores make it, correlations kept.

    This is the sandwich of White (1982), coordinate by coordinate, never narrower than before.
    With about as many coordinates as pieces, `inflate` separates almost no direction from chance;
    a single coordinate's standard error is known from p pieces to one part in sqrt(2 p).
    """
    pieces = max(spread.pieces, 2.0)
    scores = spread.scores * pieces / (pieces - 1.0)
    robust = np.einsum("ij,jk,ik->i", covariance, scores, covariance)
    wider = np.sqrt(np.maximum(robust / np.diag(covariance), 1.0))
    each: Array = covariance * np.outer(wider, wider)
    return each


def nuisance_covariance(
    problem: Problem, x: Array, parameters: Array, limit: float, doubts: Doubts
) -> Array:
    """What doubts about other parameters add to the coordinates' covariance (n, n).

    A doubt about a free parameter stands for itself: no data reduce it.

    Args:
        problem: of the last stage.
        x: (W, 7) initial states at the estimate.
        parameters: (P,) estimates.
        limit: where outliers begin.
        doubts: names and standard deviations; they must be coordinates as they are.
    """
    chart = problem.chart
    n = len(chart.free)
    added = np.zeros((n, n))
    for name, sd in doubts:
        if name in chart.free:
            added[(chart.free.index(name),) * 2] += sd**2
    others = [(name, sd) for name, sd in doubts if name not in chart.free and sd > 0.0]
    if not others:
        return added
    effects = problem.kernels.effects
    names = (*chart.free, *(name for name, _ in others))
    wide = make_chart(effects, parameters, names, chart.wheelbase)
    wider = Problem(
        problem.kernels, wide, problem.layout, problem.sigma, problem.speeds,
        problem.integrator, problem.substeps,
    )  # fmt: skip
    at = wider.evaluate(wide.coordinates(parameters), x)
    known = information(normal_equations(wider, at, limit))
    inner = known[:n, :n] + np.diag(chart.spread**-2 - wide.spread[:n] ** -2)
    carried = np.linalg.solve(inner, known[:n, n:]) * [sd for _, sd in others]
    total: Array = added + carried @ carried.T
    return total
