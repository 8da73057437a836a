"""Play a recorded Motive session to any NatNet client: same packets, same pace, from this host.

    python -m benchmarks.motive_replay traffic.pcapng
    steerd run --port … --mocap 'natnet://127.0.0.1:PORT/RaceQuad?up=y&interface=127.0.0.1'

The recording is the capture of `docs/reference/mocap-protocols.md`. CONNECT, MODELDEF and the frame
rate are answered with the packets that Motive itself sent; echo requests with Motive's clock,
carried on from the first frame; anything else is left unanswered. The frames begin with the first
model request, on the multicast group and port that the server named, each at its recorded distance
from the first (absolute deadlines). A pcapng file is read with struct alone.
"""

import argparse
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from steerd.mocap_link import natnet
from steerd.mocap_link.natnet_wire import Frame

VERSION = (3, 0)
LOOPBACK = "127.0.0.1"
ENHANCED_PACKET, UDP, IPV4 = 6, 17, b"\x08\x00"


def read_pcapng(blob: bytes) -> Iterator[tuple[int, bytes]]:
    """Times [ns] and payloads of the IPv4 UDP datagrams, Ethernet, microsecond stamps."""
    at = 0
    while at + 12 <= len(blob):
        kind, size = struct.unpack_from("<II", blob, at)
        if kind == ENHANCED_PACKET:
            _, high, low, captured, _ = struct.unpack_from("<5I", blob, at + 8)
            packet = blob[at + 28 : at + 28 + captured]
            if packet[12:14] == IPV4 and packet[23] == UDP:
                start = 14 + 4 * (packet[14] & 15)
                (length,) = struct.unpack_from(">H", packet, start + 4)
                yield (high << 32 | low) * 1000, packet[start + 8 : start + length]
        at += size


@dataclass(frozen=True)
class Capture:
    """What Motive sent: its answers as they were, and frames with their times [ns]."""

    info: natnet.ServerInfo
    info_packet: bytes
    model_packet: bytes
    rate_packet: bytes
    frames: tuple[tuple[int, bytes], ...]
    first_ticks: int


def load_capture(path: Path) -> Capture:
    """Sort a capture's packets.

    Raises:
        ValueError: one that is needed is missing.
    """
    packets: dict[type, bytes] = {}
    frames, rate, ticks, asked_rate = [], b"", 0, False
    for t_ns, data in read_pcapng(path.read_bytes()):
        message = natnet.decode(data, VERSION)
        if isinstance(message, Frame):
            ticks = ticks or message.transmit_ticks
            frames.append((t_ns, data))
        elif isinstance(message, natnet.Request):
            asked_rate = message.text == "FrameRate"
        elif isinstance(message, natnet.Response) and asked_rate:
            rate, asked_rate = rate or data, False
        else:
            packets.setdefault(type(message), data)
    if not (frames and rate and {natnet.ServerInfo, natnet.ModelDef} <= packets.keys()):
        raise ValueError(f"{path}: no whole Motive session")
    info = natnet.decode(packets[natnet.ServerInfo], VERSION)
    assert isinstance(info, natnet.ServerInfo)
    return Capture(
        info, packets[natnet.ServerInfo], packets[natnet.ModelDef], rate, tuple(frames), ticks
    )


class Replayer:
    """A server that says what Motive said."""

    def __init__(self, capture: Capture, port: int = 0) -> None:
        self._capture = capture
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, port))
        self._socket.setsockopt(
            socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK)
        )
        self.port = int(self._socket.getsockname()[1])
        self._began_ns = time.monotonic_ns()
        self._first_ns: int | None = None

    def _ticks(self, t_ns: int) -> int:
        """Motive's clock, so set that the first frame leaves when its own stamp says."""
        first_ns = self._began_ns if self._first_ns is None else self._first_ns
        since_ns = t_ns - first_ns
        return self._capture.first_ticks + since_ns * self._capture.info.clock_hz // 1_000_000_000

    def _answer(self, delay_ns: int) -> None:
        data, address = self._socket.recvfrom(65_536)
        now_ns = time.monotonic_ns()
        match natnet.decode(data, VERSION):
            case natnet.Bare.CONNECT:
                reply = self._capture.info_packet
            case natnet.Bare.REQUEST_MODEL:
                reply = self._capture.model_packet
                if self._first_ns is None:
                    self._first_ns = now_ns + delay_ns
            case natnet.Request(text="FrameRate"):
                reply = self._capture.rate_packet
            case natnet.EchoRequest(client_stamp=stamp):
                echo = natnet.EchoResponse(stamp, self._ticks(time.monotonic_ns()))
                reply = natnet.encode(echo, VERSION)
            case _:
                return
        self._socket.sendto(reply, address)

    def run(self, delay_ns: int) -> None:
        """Answer, and send every frame at its time; returns after the last.

        Args:
            delay_ns: from the first model request to the first frame.
        """
        frames = self._capture.frames
        group = (self._capture.info.group, self._capture.info.data_port)
        sent = 0
        while sent < len(frames):
            left_ns = 1_000_000_000
            if self._first_ns is not None:
                due_ns = self._first_ns + frames[sent][0] - frames[0][0]
                left_ns = due_ns - time.monotonic_ns()
                if left_ns <= 0:
                    self._socket.sendto(frames[sent][1], group)
                    sent += 1
                    continue
            if select.select([self._socket], [], [], left_ns * 1e-9)[0]:
                self._answer(delay_ns)

    def close(self) -> None:
        self._socket.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--port", type=int, default=0, help="command port; 0 takes a free one")
    parser.add_argument("--delay", type=float, default=0.5, help="before the first frame [s]")
    args = parser.parse_args()
    capture = load_capture(args.capture)
    replayer = Replayer(capture, args.port)
    url = f"natnet://{LOOPBACK}:{replayer.port}/RaceQuad?up=y&interface={LOOPBACK}"
    print(f"{len(capture.frames)} frames: {url}", flush=True)
    replayer.run(round(args.delay * 1e9))
    replayer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
