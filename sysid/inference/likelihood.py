"""The likelihood of windows under noise and a discrepancy of unknown size.

The covariance of a window's errors is `C(s) = C_healthy + s^2 U`: what instruments and ordinary
pushes make, and what an unknown push of size `s` would (`DISCREPANCY`, through the car's own
response). One rotation `T` of each window diagonalises both, `T C_healthy T' = I` and
`T U T' = diag(spectrum)` (Golub and Van Loan, Matrix Computations, 8.7.2), so a change of `s` is a
change of weights and nothing is factorised again.

One size does three jobs. It softens the likelihood while a search is far from its optimum
(annealing). It is what a gap that no effect explains leaves: the hypothesis of something else. And
it measures what is left beside an explanation (Kennedy and O'Hagan, 2001).
"""

# Why: docs/decisions/diagnosis.md#d115
# Why: docs/decisions/diagnosis.md#d119

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from steerd.sysid.data.data_checks import Array, Indices, Mask
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.disturbance_response import responses
from steerd.sysid.inference.noise import (
    Noise,
    covariance,
    instrument_variance,
    inverse_factors,
    pushed,
)
from steerd.sysid.inference.predictor import FREE_STATES, Linear, Predictor

SIZES: Array = np.concatenate([[0.0], np.geomspace(0.02, 40.0, 25)])
"""Sizes that are tried; a factor of 1.37 between them changes no decision."""


class Rotated(NamedTuple):
    """Derivatives about one point in the rotated rows."""

    by_z: Array  # (W, D, n) by the coordinates
    by_x: Array  # (W, D, 7) by the window's start
    held: Mask  # (W,) windows whose start takes no step: so bent that none keeps its promise


class Weighed(NamedTuple):
    """Rotated derivatives under one size, with the starts' part solved."""

    size: float  # of the discrepancy
    weight: Array  # (W, D) precision of each row
    turned: Array  # (W, 7, D) derivatives by starts, weighed; `heavy` (W, n, D) by coordinates
    heavy: Array
    inverse: Array  # (W, 7, 7) inverse curvature of the starts, priors included
    free: Array  # (W,) 0 where a start takes no step of its own, else 1
    cross: Array  # (W, 7, n) between starts and coordinates; `kx` the starts' step per coordinate's
    kx: Array
    h: Array  # (W, n, n) curvature with the starts eliminated
    volume: Array  # (W,) see `Reduced`

    def take(self, chosen: Indices) -> "Weighed":
        """Some of the coordinates alone."""
        return self._replace(
            heavy=self.heavy[:, chosen], cross=self.cross[:, :, chosen],
            kx=self.kx[:, :, chosen], h=self.h[:, chosen[:, None], chosen],
        )  # fmt: skip


class Reduced(NamedTuple):
    """Windows' losses as functions of the coordinates alone, about one point at one size."""

    here: Array  # (W,) whitened squared error, the start's prior included
    square: Array  # (W,) the same one step of the start on, by the derivatives
    dof: Array  # (W,) measurements of each window less what a start takes
    volume: Array  # (W,) half the log determinants of the covariance and of the start's curvature
    g: Array  # (W, n) minus the slope of half the square
    h: Array  # (W, n, n) its curvature
    dx: Array  # (W, 7) step of the start; minus `kx` (W, 7, n) per step of the coordinates
    kx: Array  # see `dx`

    def take(self, chosen: Mask) -> "Reduced":
        """Some of the windows (mask (W,)) alone."""
        return Reduced(*(part[chosen] for part in self))

    def stepped(self, dz: Array) -> Array:
        """(W,) squares were the coordinates a step on."""
        square = self.square - 2.0 * self.g @ dz + np.einsum("i,wij,j->w", dz, self.h, dz)
        return np.asarray(np.maximum(square, 0.0))

    @property
    def ratio(self) -> Array:
        """(W,) whitened squared error per degree of freedom; 1 is noise alone."""
        return np.asarray(self.square / self.dof)

    @property
    def spun(self) -> Mask:
        """(W,) windows that are so far off that they pull at nothing."""
        return np.asarray(self.ratio >= c.SPUN)

    @property
    def weight(self) -> Array:
        """(W,) weight of each window under Student's t; a window that spins barely pulls."""
        ratio = self.ratio
        return np.where(ratio < c.SPUN, 2.0 / (1.0 + ratio), 2.0 * c.SPUN_SHARE / (1.0 + ratio))

    @property
    def loss(self) -> Array:
        """(W,) negative log likelihood, the start marginalised (Laplace) [nats]."""
        return loss_of(self.here, self.dof) + self.volume


def loss_of(square: Array, dof: Array) -> Array:
    """(W,) negative log of Student's t of as many degrees as rows, flatter beyond `SPUN` [nats]."""
    ratio = np.maximum(square, 0.0) / dof
    near, whole = np.log1p(np.minimum(ratio, c.SPUN)), np.log1p(ratio)
    return np.asarray(dof * (near + c.SPUN_SHARE * (whole - near)))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Windows and how they are weighed."""

    predictor: Predictor  # the windows and the car that is simulated over them
    rotation: Array  # (W, D, D) `T`; zero for rows that are not there
    spectrum: Array  # (W, D) variance of a discrepancy of size 1 in each rotated row
    pushed: Array  # (W,) share of each window's healthy variance that is pushes, not instruments
    # (W, D, 7) derivatives by the starts about the trajectories that the responses are about,
    # rotated: what is not known of a start is taken from them alone
    by_start: Array
    log_det: Array  # (W,) half the log determinant of the healthy covariance
    _volumes: dict[float, Array] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def start_precision(self) -> Array:
        """(W, 7) prior precisions of the starts about their first guesses."""
        return np.asarray(self.predictor.start_spread**-2)

    @cached_property
    def dof(self) -> Array:
        """(W,) degrees of freedom."""
        return np.asarray(self.predictor.padded.there.sum(axis=1) - FREE_STATES)

    @property
    def left(self) -> float:
        """Size of the discrepancy that the car's own healthy drives leave; no less is allowed."""
        known = self.predictor.augmented.knowledge
        return 0.0 if known is None else known.size

    @property
    def precision(self) -> Array:
        """(W, D) precision of each reading given all others, no discrepancy allowed."""
        return np.asarray((self.rotation**2).sum(axis=1))

    def rotate(self, linear: Linear) -> Rotated:
        """Derivatives about a point, rotated."""
        held = np.zeros(len(linear.by_z), bool)
        return Rotated(self.rotation @ linear.by_z, self.rotation @ linear.by_x, held)

    def rotate_error(self, error: Array) -> Array:
        """(W, D) errors, rotated."""
        return np.asarray((self.rotation @ error[:, :, None])[:, :, 0])

    def weights(self, size: float) -> Array:
        """(W, D) precision of each rotated row."""
        return np.asarray(1.0 / (1.0 + size**2 * self.spectrum))

    def squares(self, row: Array, x: Array, size: float) -> Array:
        """(W,) whitened squares of rotated errors, the starts where they are, priors included."""
        away = self.predictor.guess - x
        white = (self.weights(size) * row**2).sum(axis=1)
        return np.asarray(white + (self.start_precision * away**2).sum(axis=1))

    def weigh(self, at: Rotated, size: float) -> "Weighed":
        """Derivatives under a discrepancy of this size, ready for any errors near their point."""
        weight = self.weights(size)
        turned, d = self.start_curvature(at.by_x, size)
        cross = turned @ at.by_z
        inverse: Array = np.asarray(np.linalg.inv(d), np.float64)
        kx, free = inverse @ cross, 1.0 - at.held.astype(np.float64)
        heavy = (at.by_z * weight[:, :, None]).transpose(0, 2, 1)
        h = heavy @ at.by_z - cross.transpose(0, 2, 1) @ kx
        return Weighed(size, weight, turned, heavy, inverse, free, cross, kx, h, self.volume(size))

    def reduce(self, by: "Weighed", error: Array, x: Array) -> Reduced:
        """Losses for errors (W, D) at starts `x`; derivatives may be of a near point."""
        return self.reduce_row(by, self.rotate_error(error), x)

    def reduce_row(self, by: "Weighed", row: Array, x: Array) -> Reduced:
        """The same for rotated errors."""
        away, pull = self.predictor.guess - x, self.start_pull(by.turned, row, x)
        dx = (by.inverse @ pull[:, :, None])[:, :, 0]
        here = (by.weight * row**2).sum(axis=1) + (self.start_precision * away**2).sum(axis=1)
        square = np.maximum(here - by.free * (pull * dx).sum(axis=1), 0.0)
        g = (by.heavy @ row[:, :, None])[:, :, 0] - (dx[:, None, :] @ by.cross)[:, 0]
        return Reduced(here, square, self.dof, by.volume, g, by.h, by.free[:, None] * dx, by.kx)

    def start_curvature(self, by_x: Array, size: float) -> tuple[Array, Array]:
        """Rotated derivatives by the starts, weighed (W, 7, D); the curvature (W, 7, 7)."""
        turned = np.ascontiguousarray((by_x * self.weights(size)[:, :, None]).transpose(0, 2, 1))
        d = turned @ by_x
        d[:, range(d.shape[1]), range(d.shape[1])] += self.start_precision
        return turned, d

    def start_pull(self, turned: Array, row: Array, x: Array) -> Array:
        """(W, 7) minus the slope of half the square along the starts, priors included."""
        pull: Array = (turned @ row[:, :, None])[:, :, 0]
        return pull + (self.predictor.guess - x) * self.start_precision

    def volume(self, size: float) -> Array:
        """(W,) half the log determinants of the covariance and of the starts' curvature.

        The same for every hypothesis: a curvature taken anew with each would change the cost along
        directions that no derivative sees (docs/decisions/diagnosis.md#d119).
        """
        if size not in self._volumes:
            d = self.start_curvature(self.by_start, size)[1]
            logs = np.linalg.slogdet(d)[1] - np.log(self.weights(size)).sum(axis=1)
            self._volumes[size] = np.asarray(0.5 * logs + self.log_det)
        return self._volumes[size]

    def best_size(self, at: Rotated, error: Array, x: Array, least: float = 0.0) -> float:
        """The size of `SIZES` under which these errors are most likely, `least` at least."""
        sizes = SIZES[min(max(least, self.left), SIZES[-1]) - 1e-12 <= SIZES]
        best, lowest, row = float(sizes[-1]), np.inf, self.rotate_error(error)
        alone = at._replace(by_z=at.by_z[:, :, :0])
        for size in sizes:
            found = self.reduce_row(self.weigh(alone, float(size)), row, x)
            cost = float((loss_of(found.square, found.dof) + found.volume).sum())
            if cost < lowest:
                best, lowest = float(size), cost
            elif cost > lowest + 50.0:
                break
        return best

    def share(self, size: float) -> float:
        """Share of the variance that a discrepancy of this size is, mean over all rows."""
        return float((1.0 - self.weights(size)).sum() / self.predictor.padded.there.sum())


def take_some(likelihood: Likelihood, chosen: Mask) -> Likelihood:
    """The likelihood of some windows (mask (W,))."""
    predictor = likelihood.predictor.take(chosen)
    width = predictor.padded.there.shape[1]
    rotation = likelihood.rotation[chosen][:, :, :width]
    parts = (likelihood.spectrum, likelihood.pushed, likelihood.by_start, likelihood.log_det)
    return Likelihood(predictor, rotation, *(part[chosen] for part in parts))


def make_likelihood(predictor: Predictor, parameters: Array, x: Array, noise: Noise) -> Likelihood:
    """The likelihood with responses about one trajectory of every window.

    Args:
        predictor: the windows.
        parameters: (P,) of the car that is pushed.
        x: (W, 7) the windows' starts.
        noise: how large instruments' noise and ordinary pushes are.
    """
    seen = responses(predictor, parameters, x, (0, 1, 2))
    healthy = covariance(predictor, noise, seen, predictor.errors(parameters, x)[0])
    unknown = pushed(seen, c.DISCREPANCY, c.DISCREPANCY_MEMORY)
    there = predictor.padded.there
    lower = inverse_factors(healthy)
    spectrum, axes = np.linalg.eigh(lower @ unknown @ lower.transpose(0, 2, 1))
    rotation = (axes.transpose(0, 2, 1) @ lower) * there[:, None, :]
    own = (lower**2 @ instrument_variance(predictor, noise)[:, :, None])[:, :, 0]
    share = ((1.0 - own) * there).sum(axis=1) / there.sum(axis=1)
    by_start = rotation @ predictor.by_starts(parameters, x)[1]
    log_det = -(np.log(np.diagonal(lower, axis1=1, axis2=2)) * there).sum(axis=1)
    return Likelihood(predictor, rotation, np.maximum(spectrum, 0.0), share, by_start, log_det)
