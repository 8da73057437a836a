"""The last lines of a run: what was driven, where it is kept, what to do with it."""

from collections.abc import Iterator
from pathlib import Path

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.terminal.dashboard import Tally


def closing_lines(plan: RunPlan, tally: Tally, session: Path) -> Iterator[str]:
    """Distance, errors, session and next command; open-loop plans have no lateral error."""
    collected = plan.drill is not None
    followed = plan.drill is None or plan.drill.closed
    yield tally.describe(lane=followed)
    yield f"session: {session}"
    if collected:
        yield f"   next: steerd identify {session} -o car.toml"
    else:
        yield f"   next: steerd plot {session}   (or steerd info)"
