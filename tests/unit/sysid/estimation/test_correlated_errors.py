"""Errors that follow each other are no news in a spread of scores."""

from types import SimpleNamespace

import numpy as np
import pytest

from steerd.sysid.estimation import robust_covariance
from steerd.sysid.estimation.objective import STATES

MOST = round(robust_covariance.CORRELATED / robust_covariance.BIN)
ROWS = 400


def _spread(monkeypatch, windows):
    monkeypatch.setattr(robust_covariance, "_scores", lambda *given: windows)
    at = SimpleNamespace(error=np.zeros(ROWS), prior_z=np.zeros(1))
    return robust_covariance.score_spread(None, at, None, 1.0)


def _lost(count):
    """What initial states and the coordinate take of the freedom."""
    return ROWS / (ROWS - 1 - STATES * count)


def test_scores_that_keep_their_sign_add_up(monkeypatch):
    length = 3 * MOST
    found = _spread(monkeypatch, [np.ones((length, 1))])
    pairs = sum((1.0 - k / (MOST + 1.0)) * (length - k) for k in range(1, MOST + 1))
    assert found.scores[0, 0] == pytest.approx((length + 2.0 * pairs) * _lost(1))
    assert found.pieces == pytest.approx(1.5 * length / MOST)


def test_scores_of_different_windows_are_strangers(monkeypatch):
    found = _spread(monkeypatch, [np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1))])
    assert found.scores[0, 0] == pytest.approx(3.0 * _lost(3))
