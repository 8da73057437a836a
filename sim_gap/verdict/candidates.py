"""Which effect: every candidate refitted with the base as nuisance, scored on drives left out.

The score is the gain in log-likelihood of windows that the fit did not see, window by window and
bounded, so that one spun window cannot decide.
"""

# Why: docs/decisions/diagnosis.md#d97

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from steerd.sim_gap.verdict.screen import Promise, extended, screen
from steerd.sysid.estimation.bounded_step import step_within
from steerd.sysid.inference.constants import GAIN_MIN, REFITS, WINSOR
from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.levenberg_marquardt import (
    Fitted,
    behind,
    curvature,
    minimise,
)

Array = NDArray[np.float64]

FAIREST = 2
"""Hypotheses from whose base that alone is tried again."""
FOLDS = 4
BLOCK = 3
"""Windows that follow each other and count as one when uncertainty is estimated."""


@dataclass(frozen=True, eq=False)
class Score:
    """A hypothesis and what it predicts of unseen windows.

    Attributes:
        effects: its effects, none for the base alone.
        fitted: at its best on all windows.
        losses: (W,) loss of each window under a fit that did not see it [nats].
        prior: half the square of the base parameters' prior deviations [nats].
    """

    effects: tuple[str, ...]
    fitted: Fitted
    losses: Array
    prior: float

    @property
    def name(self) -> str:
        """Its effects, joined."""
        return "+".join(self.effects)


def gain_of(better: Score, worse: Score, blocks: NDArray[np.int64]) -> tuple[float, float]:
    """Held-out gain of one hypothesis over another [nats], and its standard error.

    Args:
        better: one hypothesis.
        worse: the other.
        blocks: (W,) which windows follow each other.
    """
    each = np.clip(worse.losses - better.losses, -WINSOR, WINSOR)
    sums = np.bincount(blocks, weights=each)
    n = len(sums)
    se = float(np.sqrt(n) * sums.std(ddof=1)) if n > 1 else float("inf")
    return float(each.sum() + worse.prior - better.prior), se


def folds_of(engine: Engine) -> NDArray[np.int64]:
    """(W,) fold of each window: whole runs where there are enough, else interleaved blocks."""
    run = engine.readings.layout.run
    if len(np.unique(run)) >= FOLDS:
        return np.asarray(run % FOLDS)
    return np.asarray((np.arange(len(run)) // BLOCK) % FOLDS)


def blocks_of(engine: Engine) -> NDArray[np.int64]:
    """(W,) number of the block of neighbouring windows."""
    layout = engine.readings.layout
    first = np.searchsorted(layout.run, layout.run)
    within = (np.arange(len(layout.run)) - first) // BLOCK
    _, block = np.unique(layout.run * 100_000 + within, return_inverse=True)
    return np.asarray(block)


def held_out(fitted: Fitted, folds: NDArray[np.int64]) -> Array:
    """(W,) loss of each window under the fit without its fold.

    Leaving a fold out moves the optimum by one Newton step; the losses are those of the windows'
    own quadratic forms, so nothing is simulated again.
    """
    space, at = fitted.space, fitted.at
    everything = curvature(space, at)
    losses = np.empty(len(folds))
    for fold in np.unique(folds):
        out = folds == fold
        weight = at.weight * out
        h = everything - np.einsum("w,wij->ij", weight, at.h)
        slope = weight @ at.g
        dz = step_within(
            h, (at.weight @ at.g + space.prior_pull(fitted.z)) - slope,
            fitted.z, space.low, space.high,
        )  # fmt: skip
        bent = np.einsum("i,wij,j->w", dz, at.h[out], dz)
        square = np.maximum(at.square[out] - 2.0 * at.g[out] @ dz + bent, 0.0)
        losses[out] = at.dof[out] * np.log1p(square / at.dof[out])
    return losses


def scored(engine: Engine, fitted: Fitted) -> Score:
    """A fit with its held-out losses."""
    losses = held_out(fitted, folds_of(engine))
    return Score(fitted.space.effects, fitted, losses, fitted.space.base_cost(fitted.z))


def refit(
    engine: Engine,
    start: Fitted,
    nuisance: Sequence[str],
    promises: Sequence[Promise],
    beat: float = np.inf,
) -> Score | None:
    """A hypothesis with further effects, from the best of several starts; None if all diverge.

    Args:
        engine: the windows.
        start: the hypothesis to add to.
        nuisance: base parameters that are free.
        promises: what is added.
        beat: cost of a better hypothesis: one that stays far above it is not brought to its best.
    """
    space, z = extended(engine, start, nuisance, [p.effect for p in promises])
    tried = z.copy()
    values = np.concatenate([p.start for p in promises])
    tried[-len(values) :] = values
    tried = np.clip(tried, space.low, space.high)
    best: Fitted | None = None
    starts = [tried, 0.5 * (z + tried)] if len(promises) == 1 else [tried]
    if any(p.returned for p in promises):
        back = np.where(np.arange(len(z)) < space.nuisance, space.centre, tried)
        starts = [back, tried]
    for first in starts:
        try:
            found = minimise(engine, space, first, start.x.copy(), beat=beat)
        except (FloatingPointError, np.linalg.LinAlgError):
            continue
        if best is None or found.cost < best.cost:
            best = found
        if best.cost < start.cost - 0.5 * promises[0].gain or behind(best.cost, beat):
            break
    return None if best is None else scored(engine, best)


def better_base(
    engine: Engine, null: Fitted, scores: Sequence[Score], least: float
) -> Fitted | None:
    """The base alone from where the likeliest hypotheses have moved it, if that is better.

    A search may come to rest on a shoulder; any further coordinate then helps it off, and effects
    that have nothing in common gain alike. What the base alone gains there is no effect's.

    Args:
        engine: the windows.
        null: the base's fit.
        scores: hypotheses that started from it.
        least: nats by which a hypothesis must be ahead to be tried, and the base be better.
    """
    best = null
    for score in sorted(scores, key=lambda score: score.fitted.cost)[:FAIREST]:
        if score.fitted.cost > best.cost - least:
            break
        found = _without_effects(engine, null, score.fitted)
        if found is not None and found.cost < best.cost:
            best = found
    return best if best.cost < null.cost - least else None


def _without_effects(engine: Engine, null: Fitted, fitted: Fitted) -> Fitted | None:
    """The base alone, its search begun where a hypothesis has its base; None if it diverges."""
    space, moved = fitted.space, dict(zip(fitted.space.chart.free, fitted.z, strict=True))
    own = set(space.chart.free[space.nuisance :])
    names = null.space.chart.free
    z = [kept if n in own else moved.get(n, kept) for n, kept in zip(names, null.z, strict=True)]
    try:
        return minimise(engine, null.space, np.array(z), fitted.x.copy())
    except (FloatingPointError, np.linalg.LinAlgError):
        return None


def refit_all(
    engine: Engine,
    start: Fitted,
    nuisance: Sequence[str],
    promises: Sequence[Promise],
    jobs: int = 1,
    most: int = REFITS,
) -> list[Score]:
    """Refit the most promising effects, each alone; what the first few leave is to be beaten."""
    chosen = [p for p in promises if p.gain > 0.5][:most]
    found: list[Score] = []
    for batch in (chosen[:1], chosen[1:2], chosen[2:]):
        beat = min((score.fitted.cost for score in found), default=np.inf)
        tasks = (delayed(refit)(engine, start, nuisance, [p], beat) for p in batch)
        scores = Parallel(n_jobs=jobs, prefer="threads")(tasks)
        found += [score for score in scores if score is not None]
    return found


def singles(
    engine: Engine,
    null: Fitted,
    nuisance: Sequence[str],
    only: Sequence[str] | None = None,
    jobs: int = 1,
    most: int = REFITS,
    promises: Sequence[Promise] | None = None,
) -> list[Score]:
    """Every effect of the library on one footing, the most promising refitted; best first.

    Args:
        engine: the windows.
        null: the base's fit.
        nuisance: base parameters that are free.
        only: names to look at; None looks at all.
        jobs: threads.
        most: refits at most.
        promises: of `screen`, if they are known.
    """
    promises = screen(engine, null, nuisance, only) if promises is None else promises
    base = scored(engine, null)
    found = refit_all(engine, null, nuisance, promises, jobs, most)
    blocks = blocks_of(engine)
    return sorted(found, key=lambda score: -gain_of(score, base, blocks)[0])


def rank_singles(
    engine: Engine,
    null: Fitted,
    nuisance: Sequence[str],
    only: Sequence[str] | None,
    jobs: int,
    most: int,
    promises: Sequence[Promise] | None = None,
) -> tuple[Fitted, list[Score]]:
    """`singles` against the base at its best, and that base: what helps it helps no effect."""
    ranked = singles(engine, null, nuisance, only, jobs, most, promises)
    better = better_base(engine, null, ranked, GAIN_MIN)
    if better is None:
        return null, ranked
    return better, singles(engine, better, nuisance, only, jobs, most)
