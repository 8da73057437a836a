"""The world in virtual time: one car, its VESC and its mocap system, joined by bytes alone.

A caller moves time on (`World.advance`), writes and reads the serial link, and writes and reads
mocap datagrams; that is all that a driver of real hardware can do. `World.car` is for judges.
Same configuration, faults and calls give the same bytes.
"""

import errno
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sim_hw.mocap.cameras import Cameras, MocapConfig
from steerd.sim_hw.mocap.network import COMMAND, DATA, Datagram, Network, Peer
from steerd.sim_hw.mocap.servers import MocapServer, NatNetServer, VrpnDevice
from steerd.sim_hw.plant.car import CarSetup, Demand, Drive, SimCar
from steerd.sim_hw.plant.faults import Fault, make_condition
from steerd.sim_hw.plant.noise import make_noise_source
from steerd.sim_hw.vesc.vesc_device import SimVesc
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.sim_hw.vesc.vesc_wire import Logged
from steerd.vesc_link.scaling import F1TENTH, Scaling

TX_BUFFER = 4096  # bytes that the host's kernel takes for a device that does not read
_PUSH, _PUSH_NS = 0.4, 2_800_000_000
"""How fast [m/s] and how long a hand pushes the car: a metre and a bit."""


@dataclass(frozen=True)
class WorldConfig(CarSetup):
    """Everything that a simulated run depends on, besides what is done to it."""

    seed: int = 0  # root of all randomness
    # The true car, with its unmodelled effects
    model: Model[float] = field(default_factory=lambda: Model(DEFAULT_CAR))
    scaling: Scaling = F1TENTH  # how the car's servo and motor are really geared
    vesc: VescConfig = field(default_factory=VescConfig)  # the devices
    mocap: MocapConfig = field(default_factory=MocapConfig)
    keep_bytes: bool = True  # whether every serial byte is logged

    @property
    def servo_wait(self) -> float:
        """Mean wait of an angle for the next servo pulse [s]."""
        return self.vesc.servo_frame_ns / 2e9 if self.vesc.servo_out else 0.0


class World:
    """Simulated hardware from ``t_start_ns`` (the caller's now) on; faults count from there too."""

    def __init__(
        self, config: WorldConfig, faults: Sequence[Fault] = (), t_start_ns: int = 0
    ) -> None:
        self.config = config
        self.t_ns = t_start_ns  # how far time has come
        self._t_start_ns = t_start_ns
        source = partial(make_noise_source, config.seed)
        # The parts, for judges and tests
        self.car = SimCar(config.model, config, source("car"), t_start_ns)
        # Every serial byte with its time, if the configuration keeps them
        self.log: list[Logged] = []
        log = self.log if config.keep_bytes else None
        self.vesc = SimVesc(config.vesc, config.scaling, self.car, source("vesc"), log)
        self.network = Network(source("network"))
        given = config.mocap, self.network, source("server"), t_start_ns
        vrpn = config.mocap.kind == "vrpn"
        self.mocap: MocapServer = VrpnDevice(*given) if vrpn else NatNetServer(*given)
        self._cameras = Cameras(config.mocap, source("cameras"), t_start_ns)
        self._h = config.step_ns / 1e9
        self._step_ns = config.step_ns
        self._faults = tuple(faults)
        self._push, self._pushed_until_ns = Demand(Drive.SPEED, -_PUSH), t_start_ns
        self._stuck = 0
        self._apply_faults(t_start_ns)

    def add_fault(self, fault: Fault) -> None:
        """Plan another fault (its window counts from the world's start)."""
        self._faults = (*self._faults, fault)
        self._apply_faults(self.car.t_ns)

    def _apply_faults(self, t_ns: int) -> None:
        condition = make_condition(self._faults, t_ns, self._t_start_ns)
        self._edge_ns = condition.until_ns
        if not condition.vesc.stalled:
            self._stuck = 0
        self._port = f"vesc{condition.vesc.port_suffix}"
        self.vesc.set_fault_state(t_ns, condition.vesc)
        self._cameras.set_fault_state(condition.mocap)
        self.network.fault_state = condition.mocap
        self.mocap.set_fault_state(t_ns, condition.mocap)

    # --- time

    def advance(self, t_ns: int) -> None:
        """Let time pass until ``t_ns``; earlier times change nothing."""
        if t_ns <= self.t_ns and t_ns < self._edge_ns:
            return
        car, vesc, h, step_ns = self.car, self.vesc, self._h, self._step_ns
        while car.t_ns + step_ns <= t_ns:
            steer, demand = vesc.step(car.t_ns, h)
            car.step(steer, self._push if car.t_ns < self._pushed_until_ns else demand)
            now = car.t_ns
            if now >= self._edge_ns:
                self._apply_faults(now)
            if self._cameras.next_ns <= now:
                for capture in self._cameras.captures(car):
                    self.mocap.publish(capture)
        if t_ns >= self._edge_ns:
            self._apply_faults(t_ns)
        if t_ns > self.t_ns:
            self.t_ns = t_ns

    def push(self) -> None:
        """A hand pushes the car forward by a metre; the next time back to where it was."""
        self._push = Demand(Drive.SPEED, -self._push.value)
        self._pushed_until_ns = self.car.t_ns + _PUSH_NS

    @property
    def next_wake_ns(self) -> int:
        """When something may be due to be read, or may come to be under way (an exposure)."""
        step_ns, t_ns = self._step_ns, self.car.t_ns
        steps = -(-(self._cameras.next_ns - t_ns) // step_ns)
        wake = t_ns + (steps if steps > 1 else 1) * step_ns
        due = self.vesc.next_wake_ns
        if due is not None and due < wake:
            wake = due
        due = self.network.next_ns
        if due is not None and due < wake:
            wake = due
        return wake if wake < self._edge_ns else self._edge_ns

    # --- serial

    @property
    def serial_name(self) -> str | None:
        """The serial port's name as the host sees it; None while there is no device."""
        return self._port if self.vesc.connected else None

    def serial_write(self, t_ns: int, data: bytes) -> int:
        """Write to the VESC at ``t_ns``, as ``os.write`` on a non-blocking descriptor.

        Returns:
            How many bytes the kernel took.

        Raises:
            BlockingIOError: its buffer is full.
            OSError: the device is gone (EIO).
        """
        self.advance(t_ns)
        if not self.vesc.connected:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        if not self.vesc.fault_state.stalled:
            self.vesc.on_bytes(t_ns, data)
            return len(data)
        taken = min(len(data), TX_BUFFER - self._stuck)
        if not taken:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        self._stuck += taken
        return taken

    def serial_read(self, t_ns: int) -> bytes:
        """Read all that the VESC has sent by ``t_ns``; empty when there is nothing.

        Raises:
            OSError: the device is gone (EIO).
        """
        if t_ns > self.t_ns or t_ns >= self._edge_ns:
            self.advance(t_ns)
        if not self.vesc.connected:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return self.vesc.read(t_ns)

    # --- mocap

    def mocap_write(self, t_ns: int, data: bytes, channel: str = COMMAND, peer: Peer = 0) -> None:
        """Send to the server: to NatNet's command socket, or on a VRPN connection.

        On NatNet's data channel nobody listens.
        """
        self.advance(t_ns)
        if channel != DATA:
            self.mocap.on_message(t_ns, data, peer)

    def mocap_read(self, t_ns: int) -> list[Datagram]:
        """Messages that have reached the host by ``t_ns``, in order of arrival."""
        if t_ns > self.t_ns or t_ns >= self._edge_ns:
            self.advance(t_ns)
        due = self.network.next_ns
        return [] if due is None or due > t_ns else self.network.due(t_ns)
