"""The filter over parameters: only what the data replace is forgotten."""

import numpy as np
import pytest

from steerd.sim_gap.online.tracking import Track, follow, informed_directions

PRIOR = np.diag([1.0, 4.0, 0.25])


def known():
    return Track(PRIOR + np.diag([30.0, 90.0, 60.0]), np.array([3.0, -2.0, 1.0]), PRIOR)


def test_a_window_that_tells_nothing_changes_nothing():
    track = known()
    after = track
    for _ in range(5000):
        after = follow(after, np.zeros(3), np.zeros((3, 3)))
    np.testing.assert_allclose(after.information, track.information, rtol=1e-12)
    np.testing.assert_allclose(after.mean, track.mean, rtol=1e-9)


def test_only_the_direction_that_is_told_fades():
    track, h = known(), np.diag([0.0, 0.5, 0.0])
    after = track
    for _ in range(2000):
        after = follow(after, h @ track.mean, h, memory=100.0)
    np.testing.assert_allclose(after.mean, track.mean, rtol=1e-6)
    assert after.information[0, 0] == pytest.approx(track.information[0, 0])
    assert after.information[2, 2] == pytest.approx(track.information[2, 2])
    settled = PRIOR[1, 1] + 0.5 / (1.0 - np.exp(-0.01))
    assert after.information[1, 1] == pytest.approx(settled, rel=0.01)


def test_a_parameter_that_moved_is_followed_and_its_neighbours_stay():
    track, h = Track(PRIOR + 50.0 * np.eye(3), np.zeros(3), PRIOR), np.diag([2.0, 0.0, 0.0])
    for _ in range(600):
        track = follow(track, h @ np.array([0.3, 0.0, 0.0]), h, memory=60.0)
    assert track.mean[0] == pytest.approx(0.3, rel=0.02)
    np.testing.assert_allclose(track.mean[1:], 0.0, atol=1e-12)


def test_standard_deviations_never_exceed_the_prior():
    track, rng = Track(PRIOR, np.zeros(3), PRIOR), np.random.default_rng(1)
    for _ in range(300):
        slopes = rng.standard_normal((2, 3)) * np.array([1.0, 0.1, 3.0])
        track = follow(track, np.zeros(3), slopes.T @ slopes, memory=20.0)
        assert (np.diag(track.covariance) <= 1.0 / np.diag(PRIOR) + 1e-9).all()
        assert np.linalg.eigvalsh(track.information).min() > 0.0


def test_directions_do_not_depend_on_units():
    h, scale = np.diag([1.0, 1e-4, 0.3]), np.diag([1e3, 1e-2, 1.0])
    plain = informed_directions(h, PRIOR)
    turned = informed_directions(scale @ h @ scale, scale @ PRIOR @ scale)
    assert plain.shape == turned.shape == (3, 2)
