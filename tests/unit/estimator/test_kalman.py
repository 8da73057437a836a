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
@pytest.mark.parametrize("seed", range(5))
def test_update_equals_the_information_form(seed: int, width: int) -> None:
    belief, z, H, R = random_problem(seed, width)
    fused = Kalman(7).update(belief, z, H, R, np.subtract)
    information = np.linalg.inv(belief.covariance) + H.T @ np.linalg.inv(R) @ H
    covariance = np.linalg.inv(information)
    innovation = z - H @ belief.mean
    mean = belief.mean + covariance @ H.T @ np.linalg.inv(R) @ innovation
    np.testing.assert_allclose(fused.belief.mean, mean, atol=1e-9)
    np.testing.assert_allclose(fused.belief.covariance, covariance, atol=1e-9)
    np.testing.assert_allclose(fused.innovation, innovation)
    S = H @ belief.covariance @ H.T + R
    assert fused.nis == pytest.approx(innovation @ np.linalg.solve(S, innovation), rel=1e-9)


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


def test_covariance_is_exactly_symmetric() -> None:
    belief, z, H, R = random_problem(3, 3)
    covariance = Kalman(7).update(belief, z, H, R, np.subtract).belief.covariance
    assert (covariance == covariance.T).all()


def test_prediction_is_the_textbook_one() -> None:
    belief, *_ = random_problem(1, 1)
    rng = np.random.default_rng(9)
    mean, F, Q = rng.standard_normal(7), rng.standard_normal((7, 7)), np.eye(7)
    moved = Kalman(7).predict(belief, mean, F, Q)
    np.testing.assert_array_equal(moved.mean, mean)
    np.testing.assert_allclose(moved.covariance, F @ belief.covariance @ F.T + Q, atol=1e-12)


def test_box_has_no_memory_and_leaves_its_arguments_alone() -> None:
    belief, z, H, R = random_problem(2, 3)
    before = belief.mean.copy(), belief.covariance.copy()
    box = Kalman(7)
    first = box.update(belief, z, H, R, np.subtract)
    kept = first.belief.mean.copy(), first.belief.covariance.copy()
    other, *_ = random_problem(8, 3)
    box.predict(other, other.mean, np.eye(7) * 0.5, np.eye(7))
    box.update(other, z, H, R, np.subtract)
    again = box.update(belief, z, H, R, np.subtract)
    np.testing.assert_array_equal(again.belief.mean, first.belief.mean)
    assert again.nis == first.nis
    np.testing.assert_array_equal(first.belief.mean, kept[0])
    np.testing.assert_array_equal(first.belief.covariance, kept[1])
    np.testing.assert_array_equal(belief.mean, before[0])
    np.testing.assert_array_equal(belief.covariance, before[1])
