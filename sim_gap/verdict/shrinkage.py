"""How far the gap shrinks: predicted, measured on reserved drives, and over other horizons.

The prediction is made before the reserved drives are opened. The other horizons are a cross-check:
over a quarter of a second delays and gains barely show and noise rules; over three seconds small
errors have added up. A cause that is right makes the error smaller on both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from steerd.sim_gap.verdict.where import Fits
from steerd.sysid.data.data_checks import Array, Indices
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference import constants as c
from steerd.sysid.inference import residuals
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.predictor import Predictor, open_predictor
from steerd.sysid.inference.residuals import Gap, interval_of, middle_of, robust_mean
from steerd.sysid.inference.search import newton

_EXCESS_LEAST = 0.01  # below this there is no excess to take a share of
_SIGMAS = 2.0
"""How far noise alone may be from what it leaves on average, and an excess from nothing, in
standard errors."""
_WIDE = 0.5  # a share whose 90 % interval is wider says nothing of the drives it was taken from


@dataclass(frozen=True)
class Shrinkage:
    """Share of the excess whitened error that the explanation removes."""

    predicted: float  # on windows left out of the fit; `low` and `high` its 90 % interval
    low: float
    high: float
    text: str  # the prediction as it was written; `digest`: its SHA-256
    digest: str
    # On the reserved drives, None without them or where they hold too little of the gap for it
    # (then `before` says how little)
    measured: float | None = None
    before: Gap | None = None  # the gap on the reserved drives; `after` with the explanation
    after: Gap | None = None


def explained_share(before: float, after: float, floor: float) -> float:
    """Share of the excess over `floor` that is gone, within 0 and 1."""
    excess = max(before - floor, _EXCESS_LEAST)
    return float(np.clip((before - after) / excess, 0.0, 1.0))


def noise_level(best: float, draws: Array, floor: float, blocks: int) -> tuple[float, float]:
    """What noise leaves on just these drives, and how far noise alone may be from its average.

    On average it is `floor`; on few blocks it is more or less than that, by the same amount with
    and without an effect. What the effect leaves at its `best`, fitted to these drives, shows by
    how much, as long as noise alone may be so far off; what is left beyond counts as excess.
    Windows left unexplained spread its bootstrap `draws`: noise's own spread is the most.
    """
    own = c.NOISE_SPREAD * floor / np.sqrt(blocks)
    margin = _SIGMAS * min(float(draws.std()), float(own))
    return float(np.clip(best, floor - margin, floor + margin)), margin


class _Shares(NamedTuple):
    """A share of the excess with its interval, and whether the drives determine it."""

    share: float
    low: float
    high: float
    identifiable: bool


def _shares(before: Array, after: Array, best: Array, floor: float, blocks: Indices) -> _Shares:
    """The share that is gone, of windows' whitened errors before, after and at best."""
    drawn = [interval_of(values, blocks) for values in (before, after, best)]
    level, margin = noise_level(robust_mean(best), drawn[2], floor, len(np.unique(blocks)))
    share = explained_share(robust_mean(before), robust_mean(after), level)
    # Windows drawn anew carry their own noise: the floor moves with what the best leaves of them,
    # as far as that is noise.
    moved = level + np.clip(drawn[2] - robust_mean(best), -margin, margin)
    draws = [explained_share(*each) for each in zip(*drawn[:2], moved, strict=True)]
    low, high = middle_of(np.array(draws))
    excess = robust_mean(before) - level
    shown = excess > max(_EXCESS_LEAST, _SIGMAS * float((drawn[0] - moved).std()))
    return _Shares(share, low, high, shown and high - low <= _WIDE)


def predict(fits: Fits) -> _Shares:
    """Expected share on unseen drives, from windows left out."""
    left_out = residuals.held_out(fits.after, residuals.folds_of(fits.predictor))
    before, best = fits.before.at.ratio, fits.after.at.ratio
    return _shares(before, left_out, best, fits.floor, fits.blocks)


def measure(fits: Fits, reserved: Predictor, predicted: Shrinkage) -> Shrinkage:
    """The same share on reserved drives; nothing is refitted but the windows' starts."""
    fits = _look_again(fits, reserved)
    before, after = fits.before.at, fits.after.at
    # Were the hypothesis fitted to these windows: one Newton step on
    best = after.stepped(newton(fits.after.space, after, fits.after.z)[0]) / after.dof
    found = _shares(before.ratio, after.ratio, best, fits.floor, fits.blocks)
    share, gaps = found.share if found.identifiable else None, fits.gaps()
    return replace(predicted, measured=share, before=gaps[0], after=gaps[1])


def _look_again(fits: Fits, predictor: Predictor) -> Fits:
    """Both fits on other windows, their starts alone at their best."""
    likelihood = make_likelihood(predictor, fits.after.parameters, predictor.guess, fits.noise)
    both = (fits.before, fits.after)
    before, after = (residuals.settled(likelihood, fit.space, fit.z) for fit in both)
    return replace(fits, likelihood=likelihood, before=before, after=after)


CROSS: dict[float, float] = {0.25: 30.0, 3.0: np.inf}
"""Horizons of the cross-check, and how much driving each is looked at over at most [s]."""


@dataclass(frozen=True)
class Horizon:
    """Whitened error per degree of freedom over one horizon [s]; 1 is noise alone."""

    seconds: float
    before: float
    after: float


def cross_check(
    fits: Fits, runs: Sequence[Run], gaps: Sequence[Gap]
) -> tuple[tuple[Horizon, ...], list[Gap]]:
    """Whitened errors over `CROSS`, and the gaps with the errors at the longest lead added.

    Horizons longer than the drives, or over which the simulation diverges, are left out.
    """
    found = []
    for seconds, most in CROSS.items():
        if seconds > 0.5 * min(run.driven for run in runs):
            continue
        try:
            other = open_predictor(fits.predictor.augmented, runs, seconds, most)
            there = _look_again(fits, other).gaps((seconds,))
        except (FloatingPointError, ValueError, np.linalg.LinAlgError):
            continue
        found.append(Horizon(seconds, there[0].whitened, there[1].whitened))
        if seconds > 1.0:
            both = zip(gaps, there, strict=True)
            gaps = [replace(gap, errors=(*gap.errors, *more.errors)) for gap, more in both]
    return tuple(found), list(gaps)
