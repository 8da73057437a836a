"""The last lines of a run."""

from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.terminal.closing import closing_lines
from steerd.daemon.terminal.dashboard import Tally

TALLY = Tally(count=4, square=4e-4, worst=0.02, distance=12.0, driven_ns=6_000_000_000)


def lines(drill):
    plan = make_plan(RunOptions(str(default_car_path()), drill=drill), design=False)
    return list(closing_lines(plan, TALLY, Path("drive.mcap")))


def test_a_lane_was_kept():
    summary, where, then = lines("")
    assert summary.startswith("drove 12.0 m in 6.0 s; lateral error RMS 1.00 cm")
    assert where == "session: drive.mcap"
    assert "steerd plot drive.mcap" in then


@pytest.mark.parametrize(("drill", "lane"), [("mixed;speed=2", False), ("chirp;closed", True)])
def test_a_plan_was_driven(drill, lane):
    summary, _, then = lines(drill)
    assert ("lateral error" in summary) is lane
    assert "steerd identify drive.mcap -o car.toml" in then
