"""filterpy's extended Kalman filter behind plain arrays: the only file that knows the library.

filterpy 2.0.0 does the textbook algebra: `P = F P F' + Q`, the gain, the Joseph form of the
update. How the car moves and what its Jacobian is comes from outside, so the library could be
replaced by a few lines of NumPy here without any other file noticing.
"""

# Why: docs/decisions/filter-and-controller.md#d8

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter  # noqa: TID251
from scipy.linalg.lapack import dposv

from steerd.estimator.belief import Array, Belief


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


class _Box(ExtendedKalmanFilter):  # type: ignore[misc]
    """The library's filter, without what costs two thirds of its update and nobody reads.

    Motion is computed elsewhere: `u` is the predicted mean itself. The update is the library's,
    operation for operation (a test holds the two together), but for SciPy's guarded inverse,
    for which LAPACK is called directly, the copies of results and the deep copy of the measurement.
    """

    x: Array
    P: Array

    def predict_x(self, u: Any = 0) -> None:
        """The hook that the library offers for nonlinear motion."""
        self.x = u

    def correct(self, measured: Array, H: Array, R: Array, residual: Residual) -> None:
        """`ExtendedKalmanFilter.update` of a linear measurement; leaves `x`, `P`, `y` and `SI`."""
        P = self.P
        PHT = P.dot(H.T)
        S = H.dot(PHT) + R
        _, self.SI, _ = dposv(S, _UNIT[S.shape[0]])
        K = PHT.dot(self.SI)
        self.y = residual(measured, H.dot(self.x))
        self.x = self.x + K.dot(self.y)
        I_KH = self._I - K.dot(H)
        self.P = I_KH.dot(P).dot(I_KH.T) + K.dot(R).dot(K.T)


class Kalman:
    """Predictions and updates of beliefs with `size` states; no memory from call to call.

    The library keeps its work in attributes, so one box must not be used by two threads at once.
    """

    def __init__(self, size: int) -> None:
        self._box = _Box(size, 1)

    def predict(self, belief: Belief, mean: Array, transition: Array, noise: Array) -> Belief:
        """The belief after a motion to `mean` (n,) with Jacobian (n, n) and added noise (n, n)."""
        box = self._box
        box.x, box.P, box.F, box.Q = belief.mean, belief.covariance, transition, noise
        box.predict(u=mean)
        return Belief(box.x, box.P)

    def update(
        self, belief: Belief, measured: Array, matrix: Array, noise: Array, residual: Residual
    ) -> Fused:
        """The belief after a measurement (m,) with matrix (m, n) and noise covariance (m, m)."""
        box = self._box
        box.x, box.P = belief
        box.correct(measured, matrix, noise, residual)
        covariance = 0.5 * (box.P + box.P.T)
        innovation = box.y
        nis = float(innovation.dot(box.SI).dot(innovation))
        return Fused(Belief(box.x, covariance), innovation, nis)
