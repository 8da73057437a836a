"""The lateral error that pages and lists show: of a settled drive alone."""

import numpy as np
import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.info import seconds_since
from steerd.daemon.sessions.lane_error import SETTLE, find_settled, rms, settled_errors

START_NS = 10**18
RUNNING = np.array([0, 1, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1], dtype=bool)


@pytest.fixture
def state():
    """One row a second; the error is the row's number in centimetres, to either side."""
    seconds = np.arange(len(RUNNING))
    return {
        "stamp_ns": START_NS + seconds.astype(np.int64) * 10**9,
        "mode": np.where(RUNNING, int(SupervisorState.RUNNING), int(SupervisorState.ARMED)),
        "e1": 0.01 * seconds * np.where(seconds % 2, -1.0, 1.0),
    }


def test_each_start_settles_anew(state):
    assert np.flatnonzero(
        find_settled(state, seconds_since(START_NS, state["stamp_ns"]))
    ).tolist() == [4, 5, 11]
    assert SETTLE == 3.0


def test_errors_are_sizes_and_unknown_ones_are_left_out(state):
    state["e1"][5] = np.nan
    errors = settled_errors(state, seconds_since(START_NS, state["stamp_ns"]))
    assert errors == pytest.approx([0.04, 0.11])
    assert rms(errors) == pytest.approx(np.sqrt((0.04**2 + 0.11**2) / 2))


def test_nothing_has_no_error():
    assert np.isnan(rms(np.empty(0)))
