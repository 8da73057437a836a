"""When to tick next: in step with mocap, so that a pose is acted on as it arrives.

A loop with a clock of its own meets a pose at any phase, and the pose waits up to a period for its
tick. Mocap keeps time too, so the deadlines are moved, by little and little, to shortly behind
the arrivals: a phase-locked loop of first order. A pose that comes shortly before its deadline is
acted on at once; the deadline is for the pose that does not come. What arrives can stretch or
shrink a period by `SLEW` at most and never stop the ticks or make more of them; without poses, or
with poses that keep no time with the ticks (120 Hz against 100 Hz, a jittery network), the
deadlines stay where they are and every tick waits for its own.
"""

# Why: docs/decisions/processes-and-time.md#d43
# Why: docs/decisions/processes-and-time.md#d61

from typing import NamedTuple

SLEW = 0.01
"""A period changes by this share at most."""
MARGIN = 0.1
"""A deadline stands this share of a period behind a punctual arrival: room for one that is late."""
STEADY = 32
"""After so many arrivals in a row where they should be, ticks and poses are in step."""
_JITTERS = 3.0
"""And so many times the arrivals' mean jitter further."""
_SHARE = 16
"""Jitter above a period's sixteenth: no phase to follow."""
_MEMORY = 32
"""Arrivals over which jitter is averaged."""
_LATER, _EARLIER = 2, 8
"""Shares of an error taken back at once: a pose that misses its deadline waits a whole period."""


class Pace(NamedTuple):
    """How the arrivals stand to the deadlines.

    Attributes:
        arrival_ns: the newest arrival that was looked at; -1: none yet.
        lead_ns: by how much the next one should come before its deadline; negative: after.
        jitter_ns: how far arrivals miss that, on average; a whole period to begin with.
        shift_ns: how far the next deadline is moved, later if positive.
        steady: arrivals in a row that came where they should.
    """

    arrival_ns: int = -1
    lead_ns: int = 0
    jitter_ns: float = 0.0
    shift_ns: int = 0
    steady: int = 0


def step_pace(pace: Pace, due_ns: int, arrival_ns: int, period_ns: int) -> Pace:
    """Look at the newest arrival after the tick that was due at `due_ns`.

    Args:
        pace: the state before.
        due_ns: the tick's deadline.
        arrival_ns: when the newest pose arrived, on the same clock; -1: none yet.
        period_ns: between two ticks.
    """
    if arrival_ns == pace.arrival_ns:
        return pace._replace(shift_ns=0)
    lead = _wrapped(due_ns - arrival_ns, period_ns)
    if pace.arrival_ns < 0:
        return Pace(arrival_ns, lead, float(period_ns))
    missed = abs(_wrapped(lead - pace.lead_ns, period_ns))
    jitter = pace.jitter_ns + (missed - pace.jitter_ns) / _MEMORY
    shift = _shift(lead, jitter, period_ns)
    in_place = abs(lead - _lead(jitter, period_ns)) <= _room(jitter, period_ns)
    return Pace(arrival_ns, lead + shift, jitter, shift, pace.steady + 1 if in_place else 0)


def early_window_ns(pace: Pace, period_ns: int) -> int:
    """A pose that comes at most so long before a deadline [ns] is that deadline's: tick now.

    None is until ticks and poses are in step: 0.
    """
    if pace.jitter_ns * _SHARE > period_ns or pace.steady < STEADY:
        return 0
    ahead = _lead(pace.jitter_ns, period_ns) + _room(pace.jitter_ns, period_ns)
    return min(round(ahead), period_ns // 2)


def _room(jitter_ns: float, period_ns: int) -> float:
    """How far from its place an arrival may come and still be the one that is meant."""
    return period_ns / _SHARE + _JITTERS * jitter_ns


def _lead(jitter_ns: float, period_ns: int) -> float:
    """How far ahead of its deadline a punctual pose should come."""
    return MARGIN * period_ns + _JITTERS * jitter_ns


def _shift(lead_ns: int, jitter_ns: float, period_ns: int) -> int:
    """How far to move the next deadline, given where this one stood."""
    if jitter_ns * _SHARE > period_ns:
        return 0
    error = _lead(jitter_ns, period_ns) - lead_ns
    most = SLEW * period_ns
    return round(max(-most, min(most, error / (_LATER if error > 0.0 else _EARLIER))))


def _wrapped(span_ns: int, period_ns: int) -> int:
    """The span's place within a period, from half of one before to half of one after."""
    return (span_ns + period_ns // 2) % period_ns - period_ns // 2
