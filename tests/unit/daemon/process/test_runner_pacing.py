"""The runner's deadlines in a world of its own: `select` moves the clock, frames are punctual."""

from types import SimpleNamespace

import numpy as np
import pytest

from steerd.daemon.assembly.build import make_core, make_plan
from steerd.daemon.process import runner as runner_module
from steerd.daemon.process.pacing import MARGIN
from steerd.daemon.process.runner import CoreLinks, Runner
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import Tick

MS = 1_000_000
STOP, MOCAP = 3, 4


class World:
    """Time passes only in `select`; a frame comes every `every_ns`, each tick takes 0.4 ms.

    After 300 frames some are lost, and stamps may be wrong from then on.
    """

    def __init__(self, every_ns: int, lost: int = 0, ahead_ns: int = 0) -> None:
        self.t_ns, self.every_ns, self.next_ns = 0, every_ns, 3 * MS
        self.lost, self.sent, self.ahead_ns = lost, 0, ahead_ns
        self.ingest = SimpleNamespace(wheel_speed=None, stationary=False)

    def now_ns(self) -> int:
        return self.t_ns

    def realtime_ns(self) -> int:
        return self.t_ns

    def select(self, fds, _w, _x, timeout):
        end = self.t_ns + round(timeout * 1e9)
        if self.next_ns <= end:
            self.t_ns = max(self.t_ns, self.next_ns)
            return [MOCAP], [], []
        self.t_ns = end
        return [], [], []

    def fds(self):
        return [MOCAP]

    def read_ready(self, _fd):
        arrival = self.next_ns
        self.sent += 1
        missing = self.lost if self.sent == 300 else 0
        self.next_ns += self.every_ns * (1 + missing)
        wrong = self.ahead_ns if self.sent > 300 else 0
        return [SimpleNamespace(t_arrival_ns=arrival + wrong)]

    def on_timer(self, _t_ns):
        return []

    def status(self):
        return SimpleNamespace(refused=False, state="", detail="", rate_hz=0.0)

    def close(self):
        pass


def ticks_of(monkeypatch, every_ns: int, count: int = 400, **wrong: int):
    """The ticks of a run, the frames' arrivals, and the period."""
    told: list[Tick] = []

    def sink(records, _t_ns):
        told.extend(decode(Tick, r.data) for r in records if r.topic is topics.TICK)
        world.t_ns += 4 * MS // 10

    plan = make_plan(RunOptions(car_file="", path="line", speed=1.0, rate_hz=100.0))
    world = World(every_ns, **wrong)
    core = make_core(plan, 1, 0, (sink,), leased=True)
    arrivals: list[int] = []
    core.on_poses = lambda samples: arrivals.extend(s.t_arrival_ns for s in samples)
    monkeypatch.setattr(runner_module.select, "select", world.select)
    guard = SimpleNamespace(has_tripped=lambda: False)
    it = Runner(core, world, lambda: None, world, CoreLinks(None, None, (), STOP), guard)
    it._try_open = lambda _t_ns: None
    it._done = lambda: len(told) >= count
    it.run()
    return told, np.array(arrivals), plan.period_ns


def woke(ticks: list[Tick]) -> np.ndarray:
    return np.array([tick.woke_ns for tick in ticks])


def test_a_pose_is_acted_on_as_it_comes(monkeypatch):
    ticks, arrivals, period = ticks_of(monkeypatch, 10 * MS)
    assert set(woke(ticks[250:])) <= set(arrivals)
    assert np.diff(woke(ticks)).mean() == pytest.approx(period, rel=2e-3)
    assert all(0 < t.due_ns - t.woke_ns < MARGIN * period + MS // 5 for t in ticks[250:])


def test_a_pose_that_does_not_come_is_not_waited_for(monkeypatch):
    ticks, arrivals, _ = ticks_of(monkeypatch, 10 * MS, lost=10)
    gap = int(np.argmax(np.diff(arrivals)))
    blind = [t for t in ticks if arrivals[gap] < t.woke_ns < arrivals[gap + 1]]
    assert len(blind) == 10
    assert all(t.woke_ns == t.due_ns for t in blind)
    assert set(woke(ticks[-50:])) <= set(arrivals)


@pytest.mark.parametrize("ahead_ns", [3 * MS, 1_000 * MS, -3 * MS, -1_000 * MS])
def test_stamps_that_are_wrong_bring_no_tick_without_waiting(monkeypatch, ahead_ns):
    ticks, _, period = ticks_of(monkeypatch, 10 * MS, ahead_ns=ahead_ns)
    assert np.diff(woke(ticks)).min() >= period // 2
    assert all(abs(t.due_ns - t.woke_ns) <= period // 2 for t in ticks)


def test_two_poses_a_period_make_one_tick(monkeypatch):
    ticks, _, period = ticks_of(monkeypatch, 5 * MS)
    assert np.diff(woke(ticks[250:])).min() > 0.9 * period


@pytest.mark.parametrize("hz", [50, 95, 102, 250, 300, 333.3, 400, 500, 600, 800, 960, 1000])
def test_no_rhythm_of_mocap_makes_ticks_uneven(monkeypatch, hz):
    ticks, _, period = ticks_of(monkeypatch, round(1e9 / hz), count=900)
    spans = np.diff(woke(ticks[400:])) / period
    assert 0.8 < spans.min() <= spans.max() < 1.2


def test_a_mocap_of_another_rhythm_leaves_the_ticks_alone(monkeypatch):
    ticks, _, period = ticks_of(monkeypatch, 1_000_000_000 // 120)
    assert set(np.diff(woke(ticks))) == {period}


def runner_with(monkeypatch, world: World, told: list[str]) -> Runner:
    """A runner whose core only says what it is asked for."""
    core = SimpleNamespace(
        loop=SimpleNamespace(setup=SimpleNamespace(period_ns=10 * MS)),
        tick=lambda *_: told.append("decided") or b"order",
        post_tick=lambda written: told.append(f"told of {written.decode()}"),
        on_poses=lambda _samples: None,
    )
    monkeypatch.setattr(runner_module.select, "select", world.select)
    it = Runner(
        core, world, lambda: None, world, CoreLinks(None, None, (), STOP), SimpleNamespace()
    )
    it._write = lambda wire, _t_ns: told.append(wire.decode()) or wire
    it._raise_flags = it._leave = lambda: None
    it._housekeeping = lambda _t_ns: told.append("tidied")
    return it


def test_the_bytes_leave_before_anybody_is_told(monkeypatch):
    told: list[str] = []
    it = runner_with(monkeypatch, World(10 * MS), told)
    it._done = lambda: len(told) >= 8
    it.run()
    assert told == ["decided", "order", "told of order", "tidied"] * 2


def test_a_pose_makes_one_tick_only(monkeypatch):
    """A tick so late that it has seen the pose of the next one, again and again."""
    world, early = World(10 * MS), []
    it = runner_with(monkeypatch, world, [])

    def wait_too_long(due_ns: int, early_ns: int) -> None:
        early.append(early_ns > it._pose_ns)
        world.t_ns = due_ns + 8 * MS
        it._on_poses([SimpleNamespace(t_arrival_ns=due_ns + 7 * MS)])

    it._wait = wait_too_long
    it._done = lambda: len(early) >= 400
    it.run()
    assert all(early)
