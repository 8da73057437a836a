"""How large the gap is: whitened, and in millimetres, milliradians and metres per second."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from steerd.sysid.data.data_checks import Array, Indices, Mask
from steerd.sysid.data.windows import SPACING
from steerd.sysid.inference.likelihood import Likelihood
from steerd.sysid.inference.predictor import Predictor
from steerd.sysid.inference.search import Point, newton, stand, with_size
from steerd.sysid.inference.space import Space
from steerd.sysid.inference.starts import settle_starts

LEADS: tuple[float, ...] = (0.1, 0.5, 1.0)  # after a window's start, where errors are reported [s]
_SOFT = 3.0  # size of the discrepancy under which starts are sought first
_BOOTSTRAPS = 200
_FEW = 0.2  # share of the windows that may be spun; of more the model is to blame
_HALF_SLOT = 0.5 * SPACING
FOLDS = 4
BLOCK = 3  # windows that follow each other and count as one when uncertainty is estimated


class Error(NamedTuple):
    """Root mean square of an error over windows, and its 90 % interval; 0 without any."""

    value: float
    low: float
    high: float


class Lead(NamedTuple):
    """Errors so long after the windows' starts."""

    seconds: float  # how long [s]
    position: Error  # [m]; yaw: [rad]; speed: [m/s]
    yaw: Error
    speed: Error


@dataclass(frozen=True)
class Gap:
    """Prediction error of windows."""

    whitened: float  # squared error per degree of freedom, robust; 1 is noise alone
    interval: tuple[float, float]  # 90 % interval of it
    errors: tuple[Lead, ...]

    def position(self, seconds: float) -> float:
        """Root mean square of the position error after so long [m], NaN if not reported."""
        found = (lead.position.value for lead in self.errors if lead.seconds == seconds)
        return next(found, float("nan"))


def settled(likelihood: Likelihood, space: Space, z: Array, x: Array | None = None) -> Point:
    """Fixed coordinates with the starts at their best, no discrepancy allowed.

    Raises:
        FloatingPointError: the simulation diverges there.
    """
    predictor, parameters = likelihood.predictor, space.chart.parameters(z)
    x = predictor.guess if x is None else x
    x, _ = settle_starts(likelihood, parameters, x, predictor.by_starts(parameters, x), _SOFT)
    return stand(likelihood, space, z, x, 0.0)


def robust_mean(ratios: Array) -> float:
    """Mean of whitened squares in which no window counts without bound; 1 stays 1."""
    return float(np.expm1(np.log1p(np.minimum(ratios, 1e6)).mean()))


def excess_of(likelihood: Likelihood, point: Point) -> float:
    """Whitened error per degree of freedom beyond noise's, robust, no discrepancy allowed."""
    return max(robust_mean(with_size(likelihood, point, 0.0).at.ratio) - 1.0, 0.0)


def interval_of(values: Array, blocks: Indices, seed: int = 0) -> Array:
    """Bootstrap of `robust_mean` over blocks: (draws,)."""
    members = [np.flatnonzero(blocks == b) for b in np.unique(blocks)]
    drawn = np.random.default_rng(seed).integers(len(members), size=(_BOOTSTRAPS, len(members)))
    return np.array([robust_mean(values[np.concatenate([members[i] for i in d])]) for d in drawn])


def middle_of(draws: Array) -> tuple[float, float]:
    """Ends of the 90 % interval in the middle of draws."""
    low, high = np.percentile(draws, [5.0, 95.0])
    return float(low), float(high)


def spun_windows(fitted: Point) -> Mask:
    """(W,) windows in which the car spins whatever explains the others; none where all are far off.

    A chaotic second says nothing in millimetres.
    """
    spun = fitted.at.spun
    return spun & bool(spun.mean() < _FEW)


def gap_of(predictor: Predictor, fitted: Point, spun: Mask, leads: Sequence[float]) -> Gap:
    """The gap under a fit; windows that are `spun` count in the whitened error alone."""
    interval = middle_of(interval_of(fitted.at.ratio, blocks_of(predictor)))
    each = [_at_lead(predictor, fitted.linear.error, lead, ~spun) for lead in leads]
    errors = (Lead(lead, *map(_rms, kinds)) for lead, kinds in zip(leads, each, strict=True))
    return Gap(robust_mean(fitted.at.ratio), interval, tuple(errors))


def _rms(errors: Array) -> Error:
    if not len(errors):
        return Error(0.0, 0.0, 0.0)
    rng = np.random.default_rng(0)
    drawn = errors[rng.integers(len(errors), size=(_BOOTSTRAPS, len(errors)))]
    interval = middle_of(np.sqrt((drawn**2).mean(axis=1)))
    return Error(float(np.sqrt(np.mean(errors**2))), *interval)


def _at_lead(
    predictor: Predictor, error: Array, lead: float, kept: Mask
) -> tuple[Array, Array, Array]:
    """Position, yaw and speed errors of all windows near `lead` (speed from the wheel)."""
    t, channel = predictor.layout.row_t[predictor.padded.row], predictor.channel
    away = np.where((predictor.padded.there > 0.0) & kept[:, None], np.abs(t - lead), np.inf)
    planar = _nearest(away, channel <= 1)
    count = np.maximum(planar.sum(axis=1), 1) / 2.0
    position = np.sqrt((error**2 * planar).sum(axis=1) / count)[planar.any(axis=1)]
    turn, wheel = _nearest(away, channel == 2), _nearest(away, channel == 3)
    return position, error[turn], error[wheel]


def _nearest(away: Array, wanted: Mask) -> Mask:
    """Rows within half a slot of the lead; the last slot of windows may lie before it."""
    there = wanted & np.isfinite(away)
    if not there.any():
        return there
    return np.asarray(there & (away < max(0.0, away[there].min() - _HALF_SLOT) + _HALF_SLOT + 1e-3))


def folds_of(predictor: Predictor) -> Indices:
    """(W,) fold of each window: whole runs where there are enough, else interleaved blocks."""
    run = predictor.layout.run
    if len(np.unique(run)) >= FOLDS:
        return np.asarray(run % FOLDS)
    return np.asarray((np.arange(len(run)) // BLOCK) % FOLDS)


def blocks_of(predictor: Predictor) -> Indices:
    """(W,) number of the block of neighbouring windows."""
    layout = predictor.layout
    first = np.searchsorted(layout.run, layout.run)
    within = (np.arange(len(layout.run)) - first) // BLOCK
    _, block = np.unique(layout.run * 100_000 + within, return_inverse=True)
    return np.asarray(block)


def held_out(fitted: Point, folds: Indices) -> Array:
    """(W,) whitened squares per degree of freedom under the fit without each window's fold.

    Leaving a fold out moves the optimum by one Newton step; the losses are those of the windows'
    own quadratic forms, so nothing is simulated again.
    """
    left = np.empty(len(folds))
    for fold in np.unique(folds):
        out = folds == fold
        dz, _ = newton(fitted.space, fitted.at.take(~out), fitted.z)
        left[out] = fitted.at.take(out).stepped(dz)
    return left / fitted.at.dof
