"""The last lines of a run."""

from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.terminal.dashboard import Tally, closing_lines

TALLY = Tally(count=4, square=4e-4, worst=0.02, distance=12.0, driven_ns=6_000_000_000)


def lines(drill, session=Path("drive.mcap")):
    plan = make_plan(RunOptions(str(default_car_path()), drill=drill), design=False)
    return list(closing_lines(plan, TALLY, session))


def test_a_lane_was_kept():
    summary, where, then = lines("")
    assert summary.startswith("drove 12.0 m in 6.0 s; lateral error RMS 10.0 mm")
    assert where == "session: drive.mcap"
    assert "steerd plot drive.mcap" in then


@pytest.mark.parametrize(("drill", "lane"), [("mixed;speed=2", False), ("chirp;closed", True)])
def test_a_plan_was_driven(drill, lane):
    summary, _, then = lines(drill)
    assert ("lateral error" in summary) is lane
    assert "steerd identify drive.mcap -o car.toml" in then


def test_a_plan_on_an_own_car_is_identified_from_its_own_file(tmp_path):
    own = tmp_path / "mine.toml"
    own.write_text(default_car_path().read_text())
    plan = make_plan(RunOptions(str(own), drill="mixed;speed=2"), design=False)
    *_, then = closing_lines(plan, TALLY, Path("drive.mcap"))
    assert f"steerd identify drive.mcap --car {own} -o car.toml" in then
