"""A short drive of `benchmarks/no_false_stop.py`: lost and late poses stop no car."""

import pytest

from benchmarks.no_false_stop import drive_once


@pytest.mark.parametrize("seed", [1, 2])
def test_nominal_driving_with_loss_and_gaps_is_not_stopped(seed: int) -> None:
    assert drive_once(seed, 15.0).stopped == ""
