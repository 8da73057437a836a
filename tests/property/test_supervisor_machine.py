"""Random lives of a car: whatever happens in whatever order, the invariants hold."""

from math import inf, nan

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from steerd.daemon.loop import supervisor
from steerd.daemon.loop.transitions import Fact, MotorOutput, SupervisorState

CHECKED = Fact.LINKED | Fact.IDENTIFIED | Fact.CHECKS_PASS | Fact.FW_TIMEOUT
GOOD = int(CHECKED | Fact.LEASED | Fact.SLOWING)
ASKED = [Fact.ARM << k for k in range(10)]  # bits of requests; the tenth is none
UNPROVEN = {
    SupervisorState.DISARMED, SupervisorState.INIT, SupervisorState.FAULT_STOP,
    SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP,
}  # fmt: skip


class CarLife(RuleBasedStateMachine):
    """Ticks with random facts, requests, speeds and clocks; remembers what a person would ask."""

    def __init__(self):
        super().__init__()
        self.t_ns, self.facts, self.speed = 0, GOOD, 0.0
        self.memory = supervisor.make_supervisor_memory(0)
        self.action = None
        self.proven = self.requested_start = False

    def tick(self, requests, dt_ns=10_000_000):
        self.t_ns += dt_ns
        before = self.memory
        conditions = supervisor.Conditions(self.facts, self.speed, 150_000_000, "a trip")
        step = supervisor.step_supervisor
        self.memory, self.action = step(before, conditions, requests, self.t_ns)
        self.check(before, requests)

    def check(self, before, requests):
        now = self.memory.state
        if before.state == SupervisorState.SELF_TEST and now == SupervisorState.ARMED:
            self.proven = True
        if now in UNPROVEN:
            self.proven = False
        if now == SupervisorState.RUNNING:
            assert self.proven
            assert before.state == SupervisorState.RUNNING or requests & Fact.START
        if requests & Fact.CALL_ESTOP or self.facts & Fact.KILLED:
            assert now == SupervisorState.ESTOP
        if before.state == SupervisorState.RUNNING and self.facts & Fact.HARD:
            assert now in (SupervisorState.FAULT_STOP, SupervisorState.ESTOP)
        if before.state == now == SupervisorState.STOPPING:
            assert self.memory.cap <= before.cap
            assert self.memory.braking >= before.braking
        if before.state == SupervisorState.FAULT_LATCHED and now != before.state:
            assert now == SupervisorState.ESTOP or requests & Fact.CLEAR

    @rule(requests=st.sets(st.sampled_from(ASKED)).map(sum), dt_ns=st.integers(-(10**9), 10**11))
    def any_request_at_any_time(self, requests, dt_ns):
        self.tick(requests, dt_ns)

    @rule(request=st.sampled_from([0, *ASKED]), count=st.integers(1, 5))
    def one_request(self, request, count):
        for _ in range(count):
            self.tick(request)

    @rule(facts=st.integers(0, (1 << 12) - 1))
    def any_facts(self, facts):
        self.facts = facts
        self.tick(0)

    @rule(speed=st.one_of(st.just(nan), st.floats(-1, 5), st.just(0.0)))
    def another_speed(self, speed):
        self.speed = speed
        self.tick(0)

    @rule(seconds=st.sampled_from([0.1, 0.3, 1.1, 2.1]))
    def all_well_for_a_while(self, seconds):
        self.facts, self.speed = GOOD, 0.0
        for _ in range(round(seconds * 100)):
            self.tick(0)

    @precondition(lambda self: self.memory.state == SupervisorState.READY)
    @rule()
    def arm(self):
        self.tick(Fact.ARM)

    @precondition(lambda self: self.memory.state == SupervisorState.ARMED)
    @rule(speed=st.floats(0, 3))
    def start(self, speed):
        self.tick(Fact.START)
        self.speed = speed
        self.tick(0)

    @invariant()
    def motion_bytes_only_where_allowed(self):
        if self.action is None:
            return
        state, motor = self.memory.state, self.action.motor
        assert (motor == MotorOutput.DRIVE) == (state == SupervisorState.RUNNING)
        assert motor != MotorOutput.RAMP_STOP or state == SupervisorState.STOPPING
        assert 0.0 <= self.action.cap <= inf
        moving = state in (SupervisorState.RUNNING, SupervisorState.STOPPING)
        assert moving or self.action.cap == 0.0
        assert self.memory.reason
        assert supervisor.WAITING[self.memory.state]


TestCarLife = CarLife.TestCase
TestCarLife.settings = settings(derandomize=True, deadline=None, max_examples=60,
                                stateful_step_count=60)  # fmt: skip
