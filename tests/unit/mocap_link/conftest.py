"""The real capture, read with nothing but struct, and a NatNet server in a few lines."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from steerd.mocap_link import natnet
from steerd.mocap_link.natnet_frame import Frame, RigidBody

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Datagram:
    t_ns: int
    source: tuple[str, int]
    destination: tuple[str, int]
    data: bytes


def read_pcapng(blob: bytes) -> Iterator[Datagram]:
    """Yield the IPv4 UDP datagrams of enhanced packet blocks (us or ns stamps, Ethernet)."""
    at = 0
    while at + 12 <= len(blob):
        kind, size = struct.unpack_from("<II", blob, at)
        if kind == 6:
            _, high, low, captured, _ = struct.unpack_from("<5I", blob, at + 8)
            packet = blob[at + 28 : at + 28 + captured]
            datagram = parse_ethernet((high << 32 | low) * 1000, packet)
            if datagram is not None:
                yield datagram
        at += size


def parse_ethernet(t_ns: int, packet: bytes) -> Datagram | None:
    if packet[12:14] != b"\x08\x00" or packet[23] != 17:
        return None
    header = 14 + 4 * (packet[14] & 15)
    from_port, to_port, length = struct.unpack_from(">3H", packet, header)
    ips = [".".join(map(str, packet[i : i + 4])) for i in (26, 30)]
    return Datagram(
        t_ns, (ips[0], from_port), (ips[1], to_port), packet[header + 8 : header + length]
    )


@pytest.fixture(scope="session")
def capture_dir() -> Path:
    path = Path(__file__).resolve().parents[4] / "shared" / "spec" / "natnet-capture"
    if not path.is_dir():
        pytest.skip("the Motive capture (../shared/spec/natnet-capture) is not here")
    return path


@pytest.fixture(scope="session")
def capture(capture_dir: Path) -> list[Datagram]:
    return list(read_pcapng((capture_dir / "traffic.pcapng").read_bytes()))


@dataclass
class FakeServer:
    """Answers like Motive, on a clock of its own that runs `skew` off and begins anywhere."""

    version: tuple[int, int] = (4, 1)
    clock_hz: int = 3_312_787
    epoch_ticks: int = 987_654_321_012
    skew: float = 0.0
    multicast: bool = True
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
        return natnet.ServerInfo(
            "Fake", (1, 0, 0, 0), (major, minor, 0, 0), self.clock_hz, 1511, self.multicast
        )

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
