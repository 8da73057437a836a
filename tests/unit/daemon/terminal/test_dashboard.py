"""The dashboard: figures of the drive, a run's last lines, and what `steerd watch` makes of it."""

import shutil
from dataclasses import replace
from math import nan, pi
from pathlib import Path

import pytest
from rich.console import Console

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.terminal.dashboard import SETTLE_NS, Dashboard, Tally, closing_lines
from steerd.daemon.terminal.watch import SECOND, Watch, find_car
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import Sample
from tests.blank import blank
from tests.local_bus import LocalBus, LocalHub

TICK_NS = 10_000_000


def state(t_ns, x=0.0, e1=0.0, mode=SupervisorState.RUNNING):
    return blank(m.StateMessage, mono_ns=t_ns, seq=1, mode=mode, x=x, yaw=pi, e1=e1)


def printed(what):
    console = Console(width=100)
    with console.capture() as caught:
        console.print(what)
    return caught.get()


def drive(tally, ticks, e1, start_ns=0, speed=1.5):
    for i in range(ticks):
        tally.add(state(start_ns + i * TICK_NS, x=speed * i * TICK_NS * 1e-9, e1=e1))
    return tally


def test_lateral_errors_count_after_settling_and_only_where_they_are_known():
    ticks = SETTLE_NS // TICK_NS
    tally = drive(Tally(), ticks, 0.5)
    assert (tally.count, tally.worst) == (0, 0.0)
    assert tally.describe() == "drove 4.5 m in 3.0 s"
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
    unknown = replace(state(1, x=nan, e1=nan), y=nan, yaw=nan, speed=nan)
    board.take(PipeRecord(topics.STATE, 0, 1, 1, encode(unknown)))
    text = printed(board.render())
    assert "nan" not in text
    assert "x       – m" in text


# The last lines of a run.
def lines(drill, car=None):
    plan = make_plan(RunOptions(str(car or default_car_path()), drill=drill), design=False)
    tally = Tally(count=4, square=4e-4, worst=0.02, distance=12.0, driven_ns=6_000_000_000)
    return list(closing_lines(plan, tally, Path("drive.mcap")))


def test_a_lane_was_kept():
    summary, where, then = lines("")
    assert summary.startswith("drove 12.0 m in 6.0 s; lateral error RMS 10.0 mm")
    assert where == "session: drive.mcap"
    assert "steerd plot drive.mcap" in then


@pytest.mark.parametrize(("drill", "lane"), [("mixed;speed=2", False), ("chirp;closed", True)])
def test_a_plan_was_driven_and_its_own_car_file_is_identified_from(drill, lane, tmp_path):
    summary, _, then = lines(drill)
    assert ("lateral error" in summary) is lane
    assert "steerd identify drive.mcap -o car.toml" in then
    own = shutil.copy(default_car_path(), tmp_path / "mine.toml")
    assert f"steerd identify drive.mcap --car {own} -o car.toml" in lines(drill, own)[-1]


# `steerd watch`: what it shows is what was received, and silence is not standing still.
def sample(name, message):
    return Sample(f"steerd/car1/{name}", encode(message))


def test_state_rates_and_faults():
    watch = Watch(Dashboard("car1"))
    moving = sample("state", replace(state(0, e1=0.012), speed=1.5))
    faulty = sample("vesc", blank(m.VescTelemetry, fault_code=4, v_in=11.5))
    for i in range(200):
        t = i * SECOND // 100
        watch.take(moving, t)
        if i % 2:
            watch.take(faulty, t)
    assert watch.rates(2 * SECOND) == pytest.approx({"state": 100, "vesc": 50}, abs=1)
    line = watch.line(2 * SECOND)
    assert line.startswith("RUNNING       +1.50 m/s, e1 +12.0 mm; state 100, vesc 50 Hz; fault ")
    assert "none" not in line
    text = printed(watch.render(2 * SECOND))
    assert "e1  +12.0 mm" in text
    assert "11.5 V" in text
    assert "state 100" in text


def test_silence_is_reported():
    watch = Watch(Dashboard("car1"))
    assert watch.silence(9 * SECOND) == 0.0
    watch.take(sample("state", state(0)), SECOND)
    assert watch.silence(2 * SECOND) == 0.0
    assert watch.silence(5 * SECOND) == 4.0
    assert "no message for 4.0 s" in watch.line(5 * SECOND)
    assert "no message for 4.0 s" in printed(watch.render(5 * SECOND))
    watch.take(sample("state", state(0)), 6 * SECOND)
    assert watch.silence(6 * SECOND) == 0.0


def test_what_is_no_message_of_ours_is_counted_and_requests_are_left_alone():
    watch = Watch(Dashboard("car1"))
    assert watch.take(Sample("steerd/car1/state", b"\0\1\0\0nonsense"), 0) is None
    assert watch.take(Sample("steerd/car1/diagnostics", b""), 0) is None
    assert watch.undecodable == 2
    assert watch.take(Sample("steerd/car1/cmd/drive", b"x"), 0) is None
    assert watch.take(Sample("other/key", b"x"), 0) is None
    assert watch.undecodable == 2
    states = (SupervisorState.ARMED, SupervisorState.RUNNING)
    change = m.Transition(m.make_header(0, m.BODY), *states, "c", "start requested")
    assert watch.take(sample("transition", change), 0) == "RUNNING       start requested"


def test_which_car():
    hub = LocalHub()
    here, there = LocalBus(hub), LocalBus(hub)
    with pytest.raises(SteerdError, match="no car is on the bus"):
        find_car(here, None)
    there.declare_alive("steerd/blue/alive")
    assert find_car(here, None) == "blue"
    assert find_car(here, "blue") == "blue"
    with pytest.raises(SteerdError, match="no car 'red'") as caught:
        find_car(here, "red")
    assert "blue" in caught.value.hint
    there.declare_alive("steerd/red/alive")
    with pytest.raises(SteerdError, match="several"):
        find_car(here, None)
