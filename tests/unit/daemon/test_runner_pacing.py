"""The runner's deadlines in a world of its own: `select` moves the clock, frames are punctual."""

from types import SimpleNamespace

import numpy as np
import pytest

from daemon import runner as runner_module
from daemon.build import make_core, make_plan
from daemon.options import RunOptions
from daemon.pacing import MARGIN_NS
from daemon.runner import Ends, Runner
from steer_bus import topics
from steer_bus.codec import decode
from steer_bus.messages import Tick

MS = 1_000_000
STOP, MOCAP = 3, 4


class World:
    """Time passes only in `select`; a frame comes every `every_ns`, each tick takes 0.4 ms."""

    def __init__(self, every_ns: int) -> None:
        self.t_ns, self.every_ns, self.next_ns = 0, every_ns, 3 * MS
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
        arrival, self.next_ns = self.next_ns, self.next_ns + self.every_ns
        return [SimpleNamespace(t_arrival_ns=arrival)]

    def on_timer(self, _t_ns):
        return []

    def status(self):
        return SimpleNamespace(refused=False, state="", detail="", rate_hz=0.0)

    def close(self):
        pass


def ticks_of(monkeypatch, every_ns: int, count: int = 400):
    """Wake times of a run, the frames' arrivals, and the period."""
    told: list[Tick] = []

    def sink(records, _t_ns):
        told.extend(decode(Tick, r.data) for r in records if r.topic is topics.TICK)
        world.t_ns += 4 * MS // 10

    plan = make_plan(RunOptions(car_file="", path="line", speed=1.0, rate_hz=100.0))
    world = World(every_ns)
    core = make_core(plan, 1, 0, (sink,), leased=True)
    arrivals: list[int] = []
    core.on_poses = lambda samples: arrivals.extend(s.t_arrival_ns for s in samples)
    monkeypatch.setattr(runner_module.select, "select", world.select)
    guard = SimpleNamespace(tripped=lambda: False)
    it = Runner(core, world, lambda: None, world, Ends(None, None, (), STOP), guard)
    it._try_open = lambda _t_ns: None
    it._done = lambda: len(told) >= count
    it.run()
    return np.array([tick.woke_ns for tick in told]), np.array(arrivals), plan.period_ns


def test_a_pose_is_acted_on_as_it_comes(monkeypatch):
    woke, arrivals, period = ticks_of(monkeypatch, 10 * MS)
    newest = arrivals[np.searchsorted(arrivals, woke[250:], side="right") - 1]
    waits = woke[250:] - newest
    assert 0 < waits.min() <= waits.max() < MARGIN_NS + MS // 5
    assert np.diff(woke).mean() == pytest.approx(period, rel=2e-3)


def test_a_mocap_of_another_rhythm_leaves_the_ticks_alone(monkeypatch):
    woke, _, period = ticks_of(monkeypatch, 1_000_000_000 // 120)
    assert set(np.diff(woke)) == {period}
