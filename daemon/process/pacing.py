"""Tick deadlines in phase with mocap: a first-order phase-locked loop.

Without it a pose waits up to a period for its tick. The deadlines are moved slowly to shortly after
the expected arrivals, by `SLEW` of a period at most. A pose that comes shortly before its deadline
makes the tick at once; the deadline is for a pose that does not come. Without poses, or with poses
of another rate (120 Hz against 100 Hz) or much jitter, every tick waits for its own deadline.
"""

# Why: docs/decisions/processes-and-time.md#d43

from typing import NamedTuple

SLEW = 0.01  # largest change of a period, as a share of it
MARGIN = 0.1  # distance of a deadline from a punctual arrival, as a share of a period
STEADY = 32  # number of punctual arrivals in a row after which ticks and poses are in phase
_JITTERS = 3.0  # added to `MARGIN`: this factor times the mean jitter of the arrivals
_JITTER_DIVISOR = 16  # with a mean jitter above period / 16 there is no phase to follow
_MEMORY = 32  # arrivals over which the jitter is averaged
_LATER, _EARLIER = 2, 8
"""Divisors of a phase error: a pose that misses its deadline waits a period, so later is faster."""


class Pace(NamedTuple):
    """State of the phase-locked loop."""

    arrival_ns: int = -1  # the newest arrival; -1: none yet
    lead_ns: int = 0  # expected time of the next arrival before its deadline; negative: after
    jitter_ns: float = 0.0  # mean deviation from it; a whole period at first
    shift_ns: int = 0  # shift of the next deadline, later if positive
    steady: int = 0  # number of punctual arrivals in a row


def step_pace(pace: Pace, due_ns: int, arrival_ns: int, period_ns: int) -> Pace:
    """Take the newest arrival (-1: none yet) after the tick that was due at `due_ns`."""
    if arrival_ns == pace.arrival_ns:
        return pace._replace(shift_ns=0)
    half = period_ns // 2
    lead = (due_ns - arrival_ns + half) % period_ns - half
    if pace.arrival_ns < 0:
        return Pace(arrival_ns, lead, float(period_ns))
    missed = abs((lead - pace.lead_ns + half) % period_ns - half)
    jitter = pace.jitter_ns + (missed - pace.jitter_ns) / _MEMORY
    error = _lead(jitter, period_ns) - lead
    shift = 0 if jitter * _JITTER_DIVISOR > period_ns else _shift(error, period_ns)
    in_place = abs(error) <= _tolerance(jitter, period_ns)
    return Pace(arrival_ns, lead + shift, jitter, shift, pace.steady + 1 if in_place else 0)


def early_window_ns(pace: Pace, period_ns: int) -> int:
    """How long before a deadline a pose makes the tick at once [ns]; 0 while out of phase."""
    if pace.jitter_ns * _JITTER_DIVISOR > period_ns or pace.steady < STEADY:
        return 0
    ahead = _lead(pace.jitter_ns, period_ns) + _tolerance(pace.jitter_ns, period_ns)
    return min(round(ahead), period_ns // 2)


def _tolerance(jitter_ns: float, period_ns: int) -> float:
    """Largest deviation of a punctual arrival [ns]."""
    return period_ns / _JITTER_DIVISOR + _JITTERS * jitter_ns


def _lead(jitter_ns: float, period_ns: int) -> float:
    """Time of a punctual arrival before its deadline [ns]."""
    return MARGIN * period_ns + _JITTERS * jitter_ns


def _shift(error_ns: float, period_ns: int) -> int:
    """Shift of the next deadline, whose lead was too short by so much [ns]."""
    most = SLEW * period_ns
    return round(max(-most, min(most, error_ns / (_LATER if error_ns > 0.0 else _EARLIER))))
