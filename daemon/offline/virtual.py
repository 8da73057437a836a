"""Virtual time: the same core against the simulated world, as fast as the machine allows.

Deterministic: the same plan and seed give the same bytes. The clock jumps to the next event.
"""

import gc
import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from steerd.daemon.assembly.build import RunPlan, make_world_config
from steerd.daemon.ipc.pipe_records import Sink
from steerd.daemon.loop.core import Core, make_core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.transitions import SupervisorState
from steerd.mocap_link.natnet_client import NatNetSource, Socket
from steerd.sim_hw.mocap.network import COMMAND, DATA
from steerd.sim_hw.world import World, WorldConfig

_SERVER = "127.0.0.1"
_TIMER_NS = 20_000_000  # time between two calls of the mocap source's timer
_REOPEN_NS = 200_000_000  # time between two attempts to open the serial port, as in real time
_GC_THRESHOLD = 20_000
"""A drive makes many small values and no cycles; the default of 700 takes 6 % of the time."""
_GRACE_NS = 30_000_000_000  # time until a run must drive, else it is given up


@dataclass
class VirtualRun:
    """One drive in virtual time."""

    core: Core
    world: World  # the simulated hardware
    source: NatNetSource  # of mocap poses
    period_ns: int  # of the control loop
    t_ns: int = 0  # now
    # Why the drive cannot go on although the car could, or None: nothing records it
    failed: Exception | None = None

    def __post_init__(self) -> None:
        self.wire = hashlib.sha256()  # digest of every byte in both directions
        self._timer_ns = 0
        self._reopen_ns = 0
        self._opened = self.world.serial_name

    def step(self, late_ns: int = 0) -> None:
        """One period: a tick, then whatever arrives until the next.

        The process may sleep past the deadline by `late_ns`; bytes wait for it meanwhile.
        """
        due = self.t_ns
        if late_ns:
            self.world.advance(due + late_ns)
            self.t_ns = due + late_ns
            self._receive(self.t_ns)
        now = self.t_ns
        self.core.feed_back(self.source.ingest)
        data = self.core.tick(due, now)
        if data and self.core.flags & Flag.LINKED:
            self._write(now, data)
        self.core.post_tick(data)
        self._advance(due + self.period_ns * (1 + late_ns // self.period_ns))

    def _advance(self, end: int) -> None:
        """Advance to `end`, handling what arrives."""
        while self.t_ns < end:
            wake_ns, soonest_ns = self.world.next_wake_ns, self.t_ns + 1
            wake_ns = wake_ns if wake_ns > soonest_ns else soonest_ns
            self.t_ns = wake_ns if wake_ns < end else end
            self._receive(self.t_ns)

    def _write(self, t_ns: int, data: bytes) -> None:
        self.wire.update(b">" + t_ns.to_bytes(8, "big") + data)
        try:
            taken = self.world.serial_write(t_ns, data)
        except OSError:
            taken = -1
        if taken != len(data):
            self.core.lose_link()

    def _receive(self, t_ns: int) -> None:
        self._read_serial(t_ns)
        for message in self.world.mocap_read(t_ns):
            if message.channel in (COMMAND, DATA):
                which: Socket = "data" if message.channel == DATA else "command"
                self.core.on_poses(
                    self.source.on_datagram(message.data, message.t_ns, _SERVER, which)
                )
        if t_ns >= self._timer_ns:
            self._timer_ns = t_ns + _TIMER_NS
            for datagram in self.source.on_timer(t_ns):
                self.world.mocap_write(t_ns, datagram)
            self.core.on_source(self.source.status())

    def _read_serial(self, t_ns: int) -> None:
        linked = bool(self.core.flags & Flag.LINKED)
        if linked and self.world.serial_name != self._opened:
            self.core.lose_link()
        elif linked:
            try:
                data = self.world.serial_read(t_ns)
            except OSError:  # pulled out in this moment
                data = b""
                self.core.lose_link()
            if data:
                self.wire.update(b"<" + t_ns.to_bytes(8, "big") + data)
                self.core.on_serial(t_ns, data)
        elif t_ns >= self._reopen_ns:
            self._reopen_ns = t_ns + _REOPEN_NS
            self._try_open()

    def _try_open(self) -> None:
        """As the runner does it: every 200 ms, and never while the car may be driven."""
        name = self.world.serial_name
        if name is not None and self.core.may_link:
            self._opened = name
            self.core.open_link()


def make_virtual_run(
    plan: RunPlan, sinks: tuple[Sink, ...] = (), world: World | None = None
) -> VirtualRun:
    """A drive in virtual time; `world` replaces the one that the plan describes."""
    config: WorldConfig = make_world_config(plan)
    core = make_core(plan, sinks)
    core.flags |= Flag.LINKED
    source = NatNetSource(config.mocap.body, _SERVER, plan.settings.ingest)
    return VirtualRun(core, world or World(config), source, plan.period_ns)


def drive(run: VirtualRun, on_tick: Callable[[VirtualRun], None] | None = None) -> None:
    """Drive until the car is parked again after its run, or latched; what failed is raised."""
    before, loop, over = gc.get_threshold(), run.core.loop, False
    latched = (SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP)
    gc.set_threshold(_GC_THRESHOLD)
    try:
        while not over:
            run.step()
            if run.failed is not None:
                raise run.failed
            if on_tick is not None:
                on_tick(run)
            over = loop.parked and (loop.ran or run.t_ns > _GRACE_NS)
            over = over or (loop.faulted and loop.supervisor.state in latched)
    finally:
        gc.set_threshold(*before)
