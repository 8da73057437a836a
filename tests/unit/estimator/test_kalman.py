import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter  # noqa: TID251

from steerd.estimator.belief import Belief
from steerd.estimator.kalman import Kalman


def random_problem(seed: int, width: int) -> tuple[Belief, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((7, 7))
    belief = Belief(rng.standard_normal(7), root @ root.T + np.eye(7))
    return (
        belief,
        rng.standard_normal(width),
        rng.standard_normal((width, 7)),
        np.diag(rng.uniform(0.1, 2.0, width)),
    )


@pytest.mark.parametrize("width", [1, 3])
def test_update_equals_the_library_s_own(width: int) -> None:
    belief, z, H, R = random_problem(4, width)
    theirs = ExtendedKalmanFilter(7, width)
    theirs.x, theirs.P = belief
    theirs.update(z, lambda _: H, lambda x: H @ x, R=R)
    ours = Kalman(7).update(belief, z, H, R, np.subtract)
    np.testing.assert_allclose(ours.belief.mean, theirs.x, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(ours.belief.covariance, theirs.P, rtol=0.0, atol=1e-12)
    assert ours.nis == pytest.approx(theirs.mahalanobis**2, rel=1e-12)


def test_prediction_is_the_textbook_one() -> None:
    belief, *_ = random_problem(1, 1)
    rng = np.random.default_rng(9)
    mean, F, Q = rng.standard_normal(7), rng.standard_normal((7, 7)), np.eye(7)
    moved = Kalman(7).predict(belief, mean, F, Q)
    np.testing.assert_array_equal(moved.mean, mean)
    np.testing.assert_allclose(moved.covariance, F @ belief.covariance @ F.T + Q, atol=1e-12)
