"""filterpy's extended Kalman filter behind plain arrays: the only file that knows the library.

filterpy 2.0.0 does the textbook algebra: `P = F P F' + Q`, the gain, the Joseph form of the
update, the Mahalanobis distance. How the car moves and what its Jacobian is comes from outside, so
the library could be replaced by thirty lines of NumPy here without any other file noticing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter  # noqa: TID251
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Belief(NamedTuple):
    """A Gaussian belief about the state. Never changed in place."""

    mean: Array
    """(n,), in the order of `car_model.state.State`."""
    covariance: Array
    """(n, n), symmetric."""


class Fused(NamedTuple):
    """A belief after a measurement."""

    belief: Belief
    innovation: Array
    """(m,) measurement minus prediction."""
    nis: float
    """Normalised innovation squared: the squared Mahalanobis distance, chi-square of m."""


class _Moved(ExtendedKalmanFilter):  # type: ignore[misc]
    """The library's filter for a motion computed elsewhere: `u` is the predicted mean itself."""

    def predict_x(self, u: Any = 0) -> None:
        """The hook that the library offers for nonlinear motion."""
        self.x = u


class Kalman:
    """Predictions and updates of beliefs with `size` states; no memory from call to call.

    The library keeps its work in attributes, so one box must not be used by two threads at once.
    """

    def __init__(self, size: int, widths: tuple[int, ...] = (1, 3)) -> None:
        self._filters = {width: _Moved(size, width) for width in widths}
        self._first = self._filters[widths[0]]

    def predict(self, belief: Belief, mean: Array, transition: Array, noise: Array) -> Belief:
        """The belief after a motion to `mean` (n,) with Jacobian (n, n) and added noise (n, n)."""
        box = self._first
        box.x, box.P, box.F, box.Q = belief.mean, belief.covariance, transition, noise
        box.predict(u=mean)
        return Belief(box.x, box.P)

    def update(
        self,
        belief: Belief,
        measured: Array,
        matrix: Array,
        noise: Array,
        residual: Callable[[Array, Array], Array],
    ) -> Fused:
        """The belief after a measurement (m,) with matrix (m, n) and noise covariance (m, m)."""
        box = self._filters[measured.shape[0]]
        box.x, box.P = belief.mean, belief.covariance
        box.update(
            measured, lambda _: matrix, lambda mean: matrix @ mean, R=noise, residual=residual
        )
        covariance = 0.5 * (box.P + box.P.T)
        return Fused(Belief(box.x, covariance), box.y, float(box.mahalanobis) ** 2)
