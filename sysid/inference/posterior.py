"""What an optimum says: its evidence, its covariance, and how far neighbouring windows agree.

Laplace's approximation (MacKay 1992). Model errors of neighbouring windows repeat, so windows are
worth less than their number: their log likelihood is divided by Kish's design effect (Survey
Sampling, 1965, 8.2), once for a whole case. What other drives say of the base counts whole, and
an effect that healthy drives show as well is compared with what they show (see
`car_posterior.learn_controls`).
"""

# Why: docs/decisions/diagnosis.md#d116

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from steerd.sysid.data.data_checks import Array, Indices
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.likelihood import Likelihood, take_some
from steerd.sysid.inference.search import Point, curvature, minimise, stand

_PATTERNS = (1, 2, 3)  # which blocks a half has: those whose number has an odd count of these bits


@dataclass(frozen=True, eq=False)
class Posterior:
    """A hypothesis at its optimum."""

    point: Point  # the optimum
    evidence: float  # log evidence, tempered [nats]
    covariance: Array  # (n, n) of the coordinates, tempered


def design_effect(likelihood: Likelihood, size: float, controlled: bool = False) -> float:
    """How many windows are worth one under a discrepancy of this size.

    Where what repeats in healthy drives too is compared with them (`controlled`), only the
    discrepancy is common to windows, else a share of the ordinary pushes counts as well.
    """
    pushed = 0.0 if controlled else c.REPEATS * float(likelihood.pushed.mean())
    return 2.0 + (len(likelihood.pushed) - 1) * (pushed + (1.0 - pushed) * likelihood.share(size))


def posterior_of(point: Point, temper: float) -> Posterior:
    """Evidence and covariance at an optimum, with a design effect of `temper`.

    A direction without curvature keeps its prior's width: the prior is proper in every coordinate.
    """
    prior = point.space.precision
    fisher = curvature(point.space, point.at) - prior
    lower = np.linalg.cholesky(point.space.covariance)
    inner = np.linalg.eigh(lower.T @ fisher @ lower)
    gain, axes = np.maximum(inner.eigenvalues, 0.0), inner.eigenvectors
    loss, away = float(point.at.loss.sum()), point.z - point.space.centre
    prior_cost = 0.5 * float(away @ np.linalg.solve(point.space.covariance, away))
    evidence = -loss / temper - prior_cost - 0.5 * float(np.log1p(gain / temper).sum())
    wide = lower @ axes
    covariance = (wide / (1.0 + gain / temper)) @ wide.T
    return Posterior(point, evidence, covariance)


def between_halves(likelihood: Likelihood, point: Point, blocks: Indices) -> Array:
    """(n,) variance of an optimum's coordinates by balanced half-samples (McCarthy, 1969).

    One half of the blocks and the other are fitted, by some patterns. A likelihood with kinks, or a
    bent one, shows its width so; its curvature is that of one place. The point is the optimum on
    all windows; `blocks` (W,) numbers each window's block.
    """
    away = [np.zeros_like(point.z)]
    for pattern in _PATTERNS:
        odd = np.array([(int(block) & pattern).bit_count() % 2 == 1 for block in blocks])
        for half in (odd, ~odd) if 0 < odd.sum() < len(odd) else ():
            part = take_some(likelihood, half)
            try:
                begun = stand(part, point.space, point.z, point.x[half], point.size)
                away.append(minimise(part, begun).z - point.z)
            except (FloatingPointError, np.linalg.LinAlgError):
                continue
    return np.asarray(np.square(away).sum(axis=0) / max(len(away) - 1, 1))


def log_mean(data: Array, pull: Array, mean: Array, covariance: Array) -> float:
    """Log of the mean of exp(pull' x - x' data x / 2) over a normal distribution of x [nats].

    Of the data the curvature (k, k), not negative, and the slope (k,) at 0; of the distribution the
    mean (k,) and the covariance (k, k).
    """
    before = np.linalg.inv(covariance)
    whole, slope = data + before, pull + before @ mean
    volume = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(covariance)[1]
    height = slope @ np.linalg.solve(whole, slope) - mean @ before @ mean
    return 0.5 * float(height - volume)


def log_share_beyond(value: float, sd: float, null: float, least: float) -> float:
    """Log probability that a normal value differs from its null by `least` or more."""
    away, sd = abs(value - null), max(sd, 1e-12)
    return float(np.log(max(ndtr((away - least) / sd) + ndtr((-away - least) / sd), 1e-12)))
