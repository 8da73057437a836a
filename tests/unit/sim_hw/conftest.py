"""A host of the simulated world: sends commands, reads replies, all in virtual time."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World, WorldConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.packets import Reply, decode_reply, encode_command
from steerd.vesc_link.telemetry import Values

MS = 1_000_000


class Host:
    def __init__(self, world: World) -> None:
        self.world = world
        self.t_ns = 0
        self.firmware = world.config.vesc.firmware
        self.parser = FrameParser()

    def send(self, *commands: c.Command) -> None:
        data = b"".join(encode_frame(encode_command(k, self.firmware)) for k in commands)
        self.world.serial_write(self.t_ns, data)

    def run(self, ms: float) -> None:
        self.t_ns += round(ms * MS)
        self.world.advance(self.t_ns)

    def heard(self) -> list[Reply | None]:
        data = self.world.serial_read(self.t_ns)
        return [decode_reply(p, self.firmware) for p in self.parser.feed(data, self.t_ns)]

    def ask(self, command: c.Command, ms: float = 1.0) -> Any:
        self.send(command)
        self.run(ms)
        return next(iter(self.heard()[::-1]), None)

    def values(self) -> Values:
        return self.ask(c.GetValues())

    def hold(self, ms: float, *commands: c.Command) -> None:
        """Repeat commands every 10 ms, as a control loop does."""
        for _ in range(round(ms / 10)):
            self.send(*commands)
            self.run(10)

    @property
    def speed(self) -> float:
        return self.world.car.state.speed


@pytest.fixture
def make_host() -> Callable[..., Host]:
    def make(*faults: Fault, config: WorldConfig | None = None, **vesc: Any) -> Host:
        config = config or WorldConfig()
        return Host(World(replace(config, vesc=replace(config.vesc, **vesc)), faults))

    return make
