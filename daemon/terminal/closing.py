"""The last lines of a run: what was driven, where it is kept, what to do with it."""

import shlex
from collections.abc import Iterator
from pathlib import Path

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.session_meta import default_session_path
from steerd.daemon.common.screen import below_home
from steerd.daemon.terminal.dashboard import Tally


def closing_lines(plan: RunPlan, tally: Tally, session: Path) -> Iterator[str]:
    """Distance, errors, session and next command; open-loop plans have no lateral error."""
    collected = plan.drill is not None
    followed = plan.drill is None or plan.drill.closed
    yield tally.describe(lane=followed)
    # Of a folder that nobody chose, commands find the last drive by themselves.
    usual = session.parent == default_session_path("car", 0, 0).parent
    name = "@last" if usual else shlex.quote(str(session))
    yield f"session: {below_home(session) if usual else session}"
    if collected:
        own = plan.options.car_file not in ("", str(default_car_path()))
        car = f" --car {shlex.quote(plan.options.car_file)}" if own else ""
        yield f"   next: steerd identify {name}{car} -o car.toml"
    else:
        yield f"   next: steerd plot {name}   (or steerd info)"
