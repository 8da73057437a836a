"""Whether the loop keeps its time (W15): a pure count over due and wake times."""

from typing import NamedTuple

from daemon.findings import Finding, Severity, make_finding

LATE_NS = 25_000_000
"""One tick later than this stops the car."""
MISSED_RUN = 3
MISSED_SHARE = 0.02
WINDOW_NS = 1_000_000_000


class Lateness(NamedTuple):
    """Ticks that were later than one period: in a row, and over the current second."""

    run: int = 0
    ticks: int = 0
    missed: int = 0
    window_ns: int = 0
    total: int = 0


def step_lateness(
    state: Lateness, due_ns: int, woke_ns: int, period_ns: int
) -> tuple[Lateness, Finding | None]:
    """Count one tick; the finding says which of the three rules it broke."""
    late = woke_ns - due_ns
    missed = late > period_ns
    if due_ns - state.window_ns > WINDOW_NS:
        state = state._replace(ticks=0, missed=0, window_ns=due_ns)
    state = Lateness(
        run=state.run + 1 if missed else 0,
        ticks=state.ticks + 1,
        missed=state.missed + missed,
        window_ns=state.window_ns,
        total=state.total + missed,
    )
    if late > LATE_NS:
        return state, make_finding("W15", f"a tick {late / 1e6:.0f} ms late")
    if state.run >= MISSED_RUN:
        return state, make_finding("W15", f"{state.run} ticks in a row missed")
    per_second = WINDOW_NS / period_ns
    if state.missed > max(1.0, MISSED_SHARE * per_second):
        return state, make_finding("W15", f"{state.missed} of {per_second:.0f} ticks missed")
    return state, make_finding("W15", f"{late / 1e6:.1f} ms", Severity.WARN) if missed else None
