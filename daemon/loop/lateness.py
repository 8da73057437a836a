"""Lateness of the loop (W15): a pure count over due and wake times."""

# Why: docs/decisions/safety.md#d15

from typing import NamedTuple

from steerd.daemon.loop.findings import Finding, Severity, make_finding
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.quick_values import changed, quick_value

WINDOW_NS = 1_000_000_000
"""Time over which missed ticks are counted."""


class LatenessRules(NamedTuple):
    """Limits beyond which the car is stopped."""

    late_ns: int  # lateness of one tick
    run: int  # number of missed ticks in a row
    share: float  # share of missed ticks in a second


def make_lateness_rules(thresholds: Thresholds) -> LatenessRules:
    """The limits of a car file, for hardware."""
    late_ns = round(thresholds.late * 1e9)
    return LatenessRules(late_ns, thresholds.late_run, thresholds.late_share)


ON_HARDWARE = make_lateness_rules(Thresholds())
IN_SIMULATION = LatenessRules(250_000_000, 25, 0.5)
"""For a simulated car: stalls of a laptop are only counted and reported as warnings."""


@quick_value
class Lateness:
    """Missed ticks (later than one period): in a row, in the current second."""

    run: int = 0
    missed: int = 0
    window_ns: int = 0


def step_lateness(
    state: Lateness, due_ns: int, woke_ns: int, period_ns: int, rules: LatenessRules = ON_HARDWARE
) -> tuple[Lateness, Finding | None]:
    """Count one tick; the finding says which of the three limits it exceeds."""
    late = woke_ns - due_ns
    missed = late > period_ns
    if due_ns - state.window_ns > WINDOW_NS:
        state = changed(state, missed=0, window_ns=due_ns)
    run = state.run + 1 if missed else 0
    state = changed(state, run=run, missed=state.missed + missed)
    if late > rules.late_ns:
        return state, make_finding("W15", f"a tick {late / 1e6:.0f} ms late")
    if state.run >= rules.run:
        return state, make_finding("W15", f"{state.run} ticks in a row missed")
    per_second = WINDOW_NS / period_ns
    if state.missed > max(1.0, rules.share * per_second):
        return state, make_finding("W15", f"{state.missed} of {per_second:.0f} ticks missed")
    return state, make_finding("W15", f"{late / 1e6:.1f} ms", Severity.WARN) if missed else None
