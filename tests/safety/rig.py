"""A car in virtual time with a scripted operator, stopped at the moment at which a fault strikes.

Each phase of the matrix is driven to once; every cell continues a deep copy of it.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf

from steerd.controller.acceptance import make_acceptance
from steerd.controller.learnt import Design
from steerd.daemon.assembly import build
from steerd.daemon.assembly.build import NS, VIRTUAL_EPOCH_NS, RunId, RunPlan, make_plan
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.adapting import make_design, make_no_design
from steerd.daemon.loop.core import make_core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import VirtualRun
from steerd.daemon.settings.config import Settings
from steerd.daemon.settings.run_options import RunOptions
from steerd.mocap_link.natnet_client import NatNetSource
from steerd.sim_hw.mocap.cameras import Bystander
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import BODY, OperatorRequest, RequestKind, Transition, make_header
from tests.designs import design_for
from tests.safety.judge import Motion

MS = 1_000_000
BOOT_ID, LEASE_ID = 4711, 42
KEEPALIVE_NS = 100 * MS
PROPOSE_NS = 1000 * MS
MISTAKES = (
    {"steer_bias": 0.003, "steer_gain": 0.985},
    {"steer_bias": 0.006, "steer_gain": 0.97, "body_yaw": 0.004},
)
"""Cars that a learner takes this one for: near enough to pass the core's check."""
STRAIGHT, CURVE = ("line", 2.0), ("circle:radius=1.12", 2.0)
BYSTANDER = Bystander("cone", 2, (1.0, 1.5, 0.3))


class Notes:
    """The transitions that a session would hold, and the last message of each topic by its name."""

    def __init__(self) -> None:
        self.transitions: list[tuple[int, Transition]] = []
        self.last: dict[str, bytes] = {}

    def __call__(self, records: list[PipeRecord], t_ns: int) -> None:
        for record in records:
            self.last[record.topic.name] = record.data
            if record.topic is topics.TRANSITION:
                self.transitions.append((t_ns, decode(Transition, record.data)))


@dataclass
class Rig:
    """A drive, its operator, and what a judge wants to see."""

    plan: RunPlan
    run: VirtualRun
    notes: Notes
    track: list[Motion] = field(default_factory=list)  # true motion, tick by tick
    alive: bool = True  # whether the operator keeps the lease alive
    late_ns: int = 0  # lateness of the next tick
    seq: int = 0
    spoke_ns: int = -KEEPALIVE_NS
    said: list[bytes] = field(default_factory=list)
    proposals: tuple[Design | None, ...] = ()  # of a learner, in turn, None for the file's own
    propose_ns: float = inf  # when the next comes
    proposed: int = 0

    @property
    def state(self) -> SupervisorState:
        return self.run.core.loop.supervisor.state

    @property
    def t_ns(self) -> int:
        return self.run.t_ns

    @property
    def resting(self) -> bool:
        """Whether the car has truly stood for 0.3 s."""
        recent = [motion for motion in self.track[-40:] if motion.t_ns > self.t_ns - 310 * MS]
        fresh = self.t_ns - self.track[0].t_ns < 310 * MS
        return not fresh and max(abs(motion.speed) for motion in recent) < 0.01

    def ask(
        self, kind: RequestKind | int, lease_id: int = LEASE_ID, boot_id: int = BOOT_ID
    ) -> None:
        self.seq += 1
        header = make_header(self.t_ns + VIRTUAL_EPOCH_NS, BODY)
        data = encode(OperatorRequest(header, boot_id, lease_id, self.seq, kind, "judge"))
        self.said.append(data)
        self.deliver(data)

    def deliver(self, data: bytes, topic: str = topics.OPERATOR.name) -> None:
        """A message for the core, as the gateway hands it over."""
        self.run.core.on_request(topic, data, self.t_ns)

    def propose(self) -> None:
        design = self.proposals[self.proposed % len(self.proposals)]
        self.proposed += 1
        self.propose_ns = self.t_ns + PROPOSE_NS
        if design is None:
            message = make_no_design(self.t_ns, VIRTUAL_EPOCH_NS, "a change is being looked into")
        else:
            message = make_design(self.t_ns, VIRTUAL_EPOCH_NS, 1, design)
        self.run.core.on_proposal(encode(message), self.t_ns)

    def step(self) -> None:
        if self.alive and self.t_ns - self.spoke_ns >= KEEPALIVE_NS:
            self.spoke_ns = self.t_ns
            self.ask(RequestKind.KEEPALIVE)
        if self.proposals and self.t_ns >= self.propose_ns:
            self.propose()
        late_ns, self.late_ns = self.late_ns, 0
        self.run.step(late_ns)
        state = self.run.world.car.state
        self.track.append(Motion(self.run.world.car.t_ns, state.x, state.y, state.speed))

    def until(self, holds: Callable[["Rig"], bool], limit_s: float = 5.0) -> None:
        end = self.t_ns + round(limit_s * NS)
        while not holds(self):
            assert self.t_ns < end, (self.state, self.run.core.last)
            self.step()

    def reach(self, state: SupervisorState, then_s: float = 0.0) -> None:
        """Step until a state is there, and a little longer."""
        self.until(lambda rig: rig.state is state)
        self.go_on(then_s)

    def go_on(self, seconds: float) -> None:
        end = self.t_ns + round(seconds * NS)
        self.until(lambda rig: rig.t_ns >= end, seconds + 1.0)

    def drive_off(self, then_s: float = 0.0) -> None:
        """Arm and start as soon as the car lets itself, and drive a little."""
        self.reach(SupervisorState.READY)
        self.ask(RequestKind.ARM)
        self.reach(SupervisorState.ARMED, 0.2)
        self.ask(RequestKind.START)
        self.reach(SupervisorState.RUNNING, then_s)

    def break_it(self, fault: str, **params: bool | float | str) -> None:
        self.run.world.add_fault(Fault(fault, self.t_ns, **params))


def make_rig(
    path: str, speed: float, settings: Settings | None = None, *,
    adapting: bool = False, car: Mapping[str, float] | None = None,
) -> Rig:  # fmt: skip
    """A car that has just been switched on; `settings` in place of the default car file's.

    `car` says in what the simulated car differs from its file. With `adapting` a learner takes it
    for other cars, in turn, and the lane keeper follows.
    """
    plan = _plan(path, speed, adapting)
    if settings is not None:
        plan = make_plan(plan.options, settings, real=plan.real)
    config = build.make_world_config(plan)
    model = config.model._replace(car=config.model.car._replace(**(car or {})))
    mocap = replace(config.mocap, bystanders=(BYSTANDER,))
    config = replace(config, model=model, mocap=mocap, keep_bytes=True)
    notes = Notes()
    core = make_core(plan, (notes,))
    core.flags |= Flag.LINKED
    source = NatNetSource(config.mocap.body, "127.0.0.1", plan.settings.ingest)
    run = VirtualRun(core, World(config), source, plan.period_ns)
    return Rig(plan, run, notes, proposals=_mistaken(path, speed) if adapting else ())


@lru_cache
def _plan(path: str, speed: float, adapting: bool) -> RunPlan:
    options = RunOptions(car_file="", path=path, speed=speed, learn=adapting, adapt=adapting)
    return make_plan(options, real=RunId(BOOT_ID, VIRTUAL_EPOCH_NS, leased=True))


@lru_cache
def _mistaken(path: str, speed: float) -> tuple[Design | None, ...]:
    """What the learner proposes, as from a real one; then it is in doubt, and begins again."""
    held = make_acceptance(_plan(path, speed, True).controller)
    return (*(design_for(held, **cars) for cars in MISTAKES), None)


def twin(rig: Rig) -> Rig:
    """The same moment again, independent of the first."""
    del rig.run.world.log[:-8]
    memo = {
        id(rig.plan): rig.plan,
        id(rig.run.wire): rig.run.wire.copy(),
        id(rig.run.core.loop.plan): rig.run.core.loop.plan,
    }
    return copy.deepcopy(rig, memo)


PHASES = {
    "P0": "before power-on", "P1": "DISARMED", "P2": "SELF_TEST", "P3": "ARMED",
    "P4": "launch window", "P5": "RUNNING, straight", "P6": "RUNNING, bend at full lock",
    "P7": "STOPPING", "P8": "FAULT_STOP",
}  # fmt: skip


@lru_cache
def at_phase(phase: str, adapting: bool = False) -> Rig:
    """The moment of a phase at which faults strike. Use `twin` of it."""
    rig = make_rig(*(CURVE if phase == "P6" else STRAIGHT), adapting=adapting)
    if phase == "P0":
        rig.step()
        return rig
    rig.reach(SupervisorState.DISARMED, 0.1)
    if phase == "P1":
        return rig
    rig.reach(SupervisorState.READY)
    rig.ask(RequestKind.ARM)
    rig.reach(SupervisorState.SELF_TEST, 0.05)
    if phase == "P2":
        return rig
    rig.reach(SupervisorState.ARMED, 0.2)
    if phase == "P3":
        return rig
    rig.ask(RequestKind.START)
    rig.reach(SupervisorState.RUNNING)
    rig.propose_ns = rig.t_ns
    rig.reach(SupervisorState.RUNNING, 0.6)
    if phase == "P4":
        return rig
    rig.reach(SupervisorState.RUNNING, 3.0)
    if phase == "P7":
        rig.ask(RequestKind.STOP)
        rig.reach(SupervisorState.STOPPING, 0.05)
    elif phase == "P8":
        rig.run.core.flags |= Flag.SUSPENDED
        rig.reach(SupervisorState.FAULT_STOP, 0.05)
    return rig
