"""Lateness of wakes: counted against deadlines that are skipped, never caught up."""

import numpy as np
import pytest

from steerd.daemon.cli.main import dispatch
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.process.rtcheck import measure_wakes, summarise_wakes

MS = 1_000_000


class LateClock:
    """A clock whose sleeps end late by the listed times."""

    def __init__(self, late):
        self.t_ns, self.late, self.deadlines = 0, list(late), []

    def now_ns(self):
        return self.t_ns

    def realtime_ns(self):
        return self.t_ns

    def sleep_until_ns(self, deadline_ns):
        self.deadlines.append(deadline_ns)
        self.t_ns = deadline_ns + self.late.pop(0)


def test_a_missed_deadline_is_skipped():
    clock = LateClock([0, 25 * MS, 1 * MS])
    late = measure_wakes(clock, 10 * MS, 3)
    assert late.tolist() == [0, 25 * MS, 1 * MS]
    assert clock.deadlines == [10 * MS, 20 * MS, 50 * MS]


@pytest.mark.parametrize(
    ("late_ms", "good", "missed", "fatal"),
    [
        ([0.1] * 1000, True, 0, 0),
        ([0.1] * 998 + [9.0, 9.0], False, 0, 0),
        ([0.1] * 9999 + [10.0], True, 0, 0),
        ([0.1] * 9999 + [10.1], False, 1, 0),
        ([0.1] * 9999 + [25.1], False, 1, 1),
    ],
)
def test_what_is_good_enough(late_ms, good, missed, fatal):
    wakes = summarise_wakes((np.array(late_ms) * MS).astype(np.int64), 10 * MS)
    assert (wakes.good, wakes.missed, wakes.fatal) == (good, missed, fatal)
    assert wakes.ticks == len(late_ms)
    assert wakes.worst_ns == round(max(late_ms) * MS)


def test_a_measurement_of_nothing_is_refused():
    with pytest.raises(SteerdError, match="out of range"):
        dispatch(["rtcheck", "--seconds", "0"])
