"""The dashboard of a run: figures of the drive, what fits 80 columns, and the last lines."""

from dataclasses import fields, replace
from math import nan, pi
from pathlib import Path

import pytest
from rich.console import Console

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.terminal.dashboard import SETTLE_NS, Dashboard, Tally, closing_lines
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from tests.blank import blank

TICK_NS = 10_000_000


def state(t_ns, x=0.0, e1=0.0, mode=SupervisorState.RUNNING):
    return blank(m.StateMessage, mono_ns=t_ns, seq=1, mode=mode, x=x, yaw=pi, e1=e1)


def drive(tally, ticks, e1, start_ns=0, speed=1.5):
    for i in range(ticks):
        tally.add(state(start_ns + i * TICK_NS, x=speed * i * TICK_NS * 1e-9, e1=e1))
    return tally


def test_distance_and_time_count_from_the_first_running_tick():
    tally = drive(Tally(), 201, 0.0)
    assert tally.distance == pytest.approx(3.0)
    assert tally.driven_ns == 2_000_000_000
    assert tally.describe() == "drove 3.0 m in 2.0 s"


def test_lateral_errors_count_after_settling_and_only_where_they_are_known():
    ticks = SETTLE_NS // TICK_NS
    tally = drive(Tally(), ticks, 0.5)
    assert (tally.count, tally.worst) == (0, 0.0)
    tally.add(state(SETTLE_NS, e1=-0.03))
    tally.add(state(SETTLE_NS + TICK_NS, e1=0.01))
    tally.add(state(SETTLE_NS + 2 * TICK_NS, e1=nan))
    assert (tally.count, tally.worst) == (2, 0.03)
    assert tally.rms == pytest.approx(((9e-4 + 1e-4) / 2) ** 0.5)
    assert "lateral error RMS 22.4 mm, largest 30.0 mm (after 3 s)" in tally.describe()
    assert "lateral" not in tally.describe(lane=False)


def test_a_stop_between_two_drives_is_not_driven_and_settles_anew():
    tally = drive(Tally(), 401, 0.0)
    tally.add(state(5_000_000_000, mode=SupervisorState.ARMED, x=90.0))
    before = tally.count
    drive(tally, 101, 0.4, start_ns=6_000_000_000)
    assert tally.count == before
    assert tally.distance == pytest.approx(6.0 + 1.5)
    assert tally.driven_ns == 5_000_000_000


def test_an_estimate_that_is_not_there_shows_no_number():
    board = Dashboard("car1")
    numbers = {
        f.name: nan for f in fields(state(1)) if isinstance(getattr(state(1), f.name), float)
    }
    board.take(PipeRecord(topics.STATE, 0, 1, 1, encode(replace(state(1), **numbers))))
    console = Console(width=100)
    with console.capture() as caught:
        console.print(board.render())
    assert "nan" not in caught.get()
    assert "x       – m" in caught.get()


# The last lines of a run.

TALLY = Tally(count=4, square=4e-4, worst=0.02, distance=12.0, driven_ns=6_000_000_000)


def lines(drill, car=None):
    plan = make_plan(RunOptions(str(car or default_car_path()), drill=drill), design=False)
    return list(closing_lines(plan, TALLY, Path("drive.mcap")))


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
    assert f"steerd identify drive.mcap --car {own} -o car.toml" in lines("mixed;speed=2", own)[-1]
