"""The extended Kalman filter's algebra behind plain arrays: `P = F P F' + Q`, gain, Joseph form.

How the car moves and what its Jacobian is comes from outside. A test holds prediction and update to
filterpy's, the library that users know: what it brings along takes a second to load. Its guarded
inverse is LAPACK's here, called directly.
"""

# Why: docs/decisions/filter-and-controller.md#d8
# Why: docs/decisions/filter-and-controller.md#d33
# Why: docs/decisions/filter-and-controller.md#d60
# Why: docs/decisions/filter-and-controller.md#d90

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

Array = NDArray[np.float64]


class Belief(NamedTuple):
    """A Gaussian belief about the state. Never changed in place."""

    mean: Array
    """(n,), in the order of `steerd.car_model.state.State`."""
    covariance: Array
    """(n, n), symmetric."""


class Fused(NamedTuple):
    """A belief after a measurement."""

    belief: Belief
    innovation: Array
    """(m,) measurement minus prediction."""
    nis: float
    """Normalised innovation squared: the squared Mahalanobis distance, chi-square of m."""


Residual = Callable[[Array, Array], Array]
"""Measurement and expectation to innovation."""


_UNIT = {width: np.eye(width) for width in range(1, 8)}


class Kalman:
    """Predictions and updates of beliefs with `size` states; no memory from call to call."""

    def __init__(self, size: int) -> None:
        self._unit = np.eye(size)

    def predict(self, belief: Belief, mean: Array, transition: Array, noise: Array) -> Belief:
        """The belief after a motion to `mean` (n,) with Jacobian (n, n) and added noise (n, n)."""
        return Belief(mean, transition.dot(belief.covariance).dot(transition.T) + noise)

    def update(
        self, belief: Belief, measured: Array, matrix: Array, noise: Array, residual: Residual
    ) -> Fused:
        """The belief after a measurement (m,) with matrix (m, n) and noise covariance (m, m)."""
        x, P, H, R = *belief, matrix, noise
        PHT = P.dot(H.T)
        S = H.dot(PHT) + R
        _, SI, _ = dposv(S, _UNIT[S.shape[0]])
        K = PHT.dot(SI)
        innovation = residual(measured, H.dot(x))
        mean = x + K.dot(innovation)
        I_KH = self._unit - K.dot(H)
        P = I_KH.dot(P).dot(I_KH.T) + K.dot(R).dot(K.T)
        nis = float(innovation.dot(SI).dot(innovation))
        return Fused(Belief(mean, 0.5 * (P + P.T)), innovation, nis)
