"""A supervisor with settable conditions, ticked by hand."""

from steerd.daemon.loop.supervisor import Conditions, make_supervisor_memory, step_supervisor
from steerd.daemon.loop.transitions import ARMED, READY, RUNNING, Fact, Request

MS = 1_000_000
GOOD = (
    Fact.LINKED | Fact.IDENTIFIED | Fact.CHECKS_PASS | Fact.LEASED | Fact.ESTIMATED | Fact.SLOWING
)
TIMEOUT_NS = 150 * MS


class Car:
    """A supervisor with conditions that a test turns on and off."""

    def __init__(self):
        self.t_ns, self.facts, self.speed, self.text = 0, GOOD | Fact.FW_TIMEOUT, 0.0, ""
        self.memory = make_supervisor_memory(0)
        self.action = None

    def tick(self, requests=0, dt=10 * MS):
        self.t_ns += dt
        conditions = Conditions(int(self.facts), self.speed, TIMEOUT_NS, self.text)
        self.memory, self.action = step_supervisor(self.memory, conditions, requests, self.t_ns)
        return self.memory.state

    def ticks(self, count, dt=10 * MS):
        return [self.tick(dt=dt) for _ in range(count)][-1]

    def outputs(self):
        return self.action.motor, self.action.steering

    def until(self, state, limit=1000):
        for count in range(limit):
            if self.tick() == state:
                return count
        raise AssertionError(f"stayed in {self.memory.state.name}: {self.action}")

    def ready(self):
        self.until(READY)
        return self

    def armed(self):
        self.ready().tick(Request.ARM)
        self.until(ARMED)
        self.facts &= ~Fact.FW_TIMEOUT
        return self

    def running(self, speed=2.0):
        self.armed().tick(Request.START)
        self.facts |= Fact.LAUNCHED
        self.speed = speed
        self.tick()
        assert self.memory.state == RUNNING
        return self
