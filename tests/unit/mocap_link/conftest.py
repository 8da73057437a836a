"""A NatNet server in a few lines."""

import struct
from dataclasses import dataclass, field

import pytest

from steerd.mocap_link import natnet
from steerd.mocap_link.natnet_frame import Frame, RigidBody

SECOND = 1_000_000_000


@dataclass
class FakeServer:
    """Answers like Motive, on a clock of its own that runs `skew` off and begins anywhere."""

    version: tuple[int, int] = (4, 1)
    clock_hz: int = 3_312_787
    epoch_ticks: int = 987_654_321_012
    skew: float = 0.0
    multicast: bool = True
    data_port: int = 1511
    group: str = "239.255.42.99"
    bodies: tuple[natnet.RigidBodyDesc, ...] = (
        natnet.RigidBodyDesc("car", 1),
        natnet.RigidBodyDesc("b2", 2),
    )
    number: int = 0
    received: list[natnet.Message] = field(default_factory=list)

    def ticks(self, t_ns: int) -> int:
        return self.epoch_ticks + round(t_ns * (1 + self.skew) * self.clock_hz / SECOND)

    def info(self) -> natnet.ServerInfo:
        major, minor = self.version
        clock_and_data = self.clock_hz, self.data_port, self.multicast, self.group
        return natnet.ServerInfo("Fake", (1, 0, 0, 0), (major, minor, 0, 0), *clock_and_data)

    def answer(self, datagram: bytes, t_ns: int) -> list[bytes]:
        message = natnet.decode(datagram, self.version)
        self.received.append(message)
        match message:
            case natnet.Bare.CONNECT:
                reply: natnet.Message = self.info()
            case natnet.Bare.REQUEST_MODEL:
                reply = natnet.ModelDef(self.bodies)
            case natnet.Request(text="FrameRate"):
                reply = natnet.Response(struct.pack("<f", 100.0))
            case natnet.EchoRequest():
                reply = natnet.EchoResponse(message.client_stamp, self.ticks(t_ns))
            case _:
                return []
        return [natnet.encode(reply, self.version)]

    def frame(
        self,
        t_exposed_ns: int,
        bodies: tuple[RigidBody, ...],
        *,
        t_sent_ns: int | None = None,
        params: int = 0,
    ) -> bytes:
        self.number += 1
        sent = t_exposed_ns + 5_000_000 if t_sent_ns is None else t_sent_ns
        frame = Frame(
            self.number,
            bodies,
            timestamp=t_exposed_ns * 1e-9,
            mid_exposure_ticks=self.ticks(t_exposed_ns),
            data_received_ticks=self.ticks(t_exposed_ns),
            transmit_ticks=self.ticks(sent),
            params=params,
        )
        return natnet.encode(frame, self.version)


@pytest.fixture
def make_server() -> type[FakeServer]:
    return FakeServer
