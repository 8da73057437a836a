"""Dead time: a held signal that arrives late."""

from collections import deque
from typing import NamedTuple


class Held(NamedTuple):
    """A value and the time from which it is in force [ns]."""

    t_ns: int
    value: float


class DelayLine:
    """A signal held between changes, read `delay_ns` late.

    Args:
        delay_ns: dead time, zero or more.
        initial: value before the first change.
    """

    def __init__(self, delay_ns: int, initial: float) -> None:
        self._delay_ns = max(0, delay_ns)
        self._now = initial
        self._newest = initial
        self._coming: deque[Held] = deque()

    def push(self, t_ns: int, value: float) -> None:
        """Hold ``value`` from ``t_ns`` on; times never go back."""
        if value != self._newest:
            self._newest = value
            self._coming.append(Held(t_ns + self._delay_ns, value))

    def mean(self, t0_ns: int, t1_ns: int) -> float:
        """Mean of the late signal over [t0, t1); later calls start at ``t1`` or after.

        As `steerd.car_model.rollout.channel_delayed`, for changes at any time.
        """
        coming = self._coming
        while coming and coming[0].t_ns <= t0_ns:
            self._now = coming.popleft().value
        if not coming or coming[0].t_ns >= t1_ns:
            return self._now
        area, since = 0.0, t0_ns
        while coming and coming[0].t_ns < t1_ns:
            change = coming.popleft()
            area += self._now * (change.t_ns - since)
            self._now, since = change.value, change.t_ns
        return (area + self._now * (t1_ns - since)) / (t1_ns - t0_ns)
