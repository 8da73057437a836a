"""NatNet and VRPN over loopback: server and receiver take turns in one thread, so nothing races."""

import select
import socket
import struct
import time
from contextlib import ExitStack, closing, contextmanager
from itertools import pairwise
from types import SimpleNamespace

import pytest

from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.sockets import NatNetReceiver, VrpnReceiver, make_receiver, map_stamp
from steerd.mocap_link.source import ClockKind, SourceState
from steerd.sim_hw.mocap.cameras import MocapConfig
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.mocap_sockets import NatNetSockets, VrpnSockets
from steerd.sim_hw.world import World, WorldConfig
from tests.safety.live import free_port

MS = 1_000_000
SECOND = 1000 * MS
LOOPBACK = "127.0.0.1"
CONFIG = IngestConfig(frame=FrameConfig())


def drive(receiver, pump, done, samples):
    """Alternate server and receiver until `done`, at most 30 s."""
    end = time.monotonic_ns() + 30 * SECOND
    while not done():
        assert time.monotonic_ns() < end, receiver.status()
        pump()
        receiver.on_timer(time.monotonic_ns())
        ready, _, _ = select.select(receiver.fds(), [], [], 0.005)
        for fd in ready:
            samples += receiver.read_ready(fd)


def follow(connect, server, count=5, **more):
    """A receiver of this server that has had more than `count` poses, and they."""
    receiver, samples = connect(server.url, **more), []
    drive(receiver, server.pump, lambda: len(samples) > count, samples)
    return receiver, samples


class Server:
    """The simulated mocap server on loopback; its clock is this host's plus 10^15 ns."""

    def __init__(self, **mocap) -> None:
        self.begun_ns = time.monotonic_ns()
        clock = {"clock_hz": SECOND, "epoch_ticks": 10**15 + self.begun_ns, "skew_ppm": 0.0}
        self.world = World(WorldConfig(mocap=MocapConfig(**clock, **mocap), keep_bytes=False))
        made = VrpnSockets if mocap.get("kind") == "vrpn" else NatNetSockets
        self.sockets = made(self.world.mocap)
        self.url = self.sockets.url

    def pump(self) -> None:
        self.sockets.pump(self.world, time.monotonic_ns() - self.begun_ns)


@contextmanager
def serving(**mocap):
    with closing((server := Server(**mocap)).sockets):
        yield server


@pytest.fixture(params=[True, False], ids=["multicast", "unicast"])
def udp_server(request):
    with serving(multicast=request.param) as server:
        yield server


@pytest.fixture
def tcp_server():
    with serving(kind="vrpn") as server:
        yield server


@pytest.fixture
def connect():
    with ExitStack() as made:
        yield lambda url, **more: made.enter_context(
            closing(make_receiver(parse_mocap_url(url), CONFIG, **more))
        )


def test_natnet_poses_arrive_with_their_exposure_time(udp_server, connect):
    receiver, samples = follow(connect, udp_server, 60)
    assert isinstance(receiver, NatNetReceiver)
    assert receiver.interface == LOOPBACK
    drive(receiver, udp_server.pump, lambda: receiver.status().state is SourceState.OK, samples)
    assert all(s.rejected is None for s in samples)
    drive(receiver, udp_server.pump, lambda: samples[-1].clock is ClockKind.ECHO, samples)
    last = samples[-1]
    # the server's clock is this host's plus 10^15: the map must find that within the echo's
    # half round trip, itself bounded by this thread's turn-taking
    sigma = receiver.status().clock_sigma_ns
    assert abs(last.t_valid_ns - (last.source_ticks - 10**15)) < sigma + 2 * MS
    assert last.t_valid_ns <= last.t_arrival_ns <= time.monotonic_ns()
    status = receiver.status()
    assert (status.server, status.bodies) == ("steerd simulated Motive NatNet 4.1", ("car",))
    assert len(receiver.fds()) == 2


@pytest.mark.parametrize("udp_server", [False], indirect=True)
def test_natnet_backlog_keeps_the_newest_five(udp_server, connect):
    receiver, samples = follow(connect, udp_server)
    udp_server.begun_ns -= 400 * MS
    udp_server.pump()
    select.select(receiver.fds(), [], [], 1.0)
    late = receiver.read_ready(receiver.fds()[0])
    assert 1 <= len(late) <= 5
    assert late[-1].frame > samples[-1].frame + 30


@pytest.mark.parametrize("udp_server", [False], indirect=True)
def test_natnet_data_port_that_is_taken_is_tried_again(udp_server, connect):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((LOOPBACK, udp_server.sockets.data_port))
        # unicast frames may come to the command socket, so this is no reason to stop
        receiver, _ = follow(connect, udp_server)
        assert f"data port {udp_server.sockets.data_port}" in receiver.status().detail
        assert len(receiver.fds()) == 1
    receiver.on_timer(time.monotonic_ns() + 2 * SECOND)
    assert len(receiver.fds()) == 2
    assert "data port" not in receiver.status().detail


@pytest.mark.parametrize("udp_server", [True], indirect=True)
def test_natnet_server_comes_back_on_another_data_port(udp_server, connect):
    receiver, samples = follow(connect, udp_server)
    udp_server.sockets.data_port = udp_server.world.mocap.data_port = free_port()
    samples.clear()
    drive(receiver, udp_server.pump, lambda: len(samples) > 5, samples)
    assert len(receiver.fds()) == 2


def test_vrpn_poses_and_reconnect(tcp_server, connect):
    receiver, samples = follow(connect, tcp_server, 50)
    assert all(s.rejected is None for s in samples)
    assert {b.source_ticks - a.source_ticks for a, b in pairwise(samples)} == {10_000}
    assert receiver.source.up
    restart_ns = time.monotonic_ns() - tcp_server.begun_ns
    tcp_server.world.add_fault(Fault("server_restart", restart_ns, restart_ns + MS))
    drive(receiver, tcp_server.pump, lambda: not receiver.source.up, samples)
    samples.clear()
    drive(receiver, tcp_server.pump, lambda: len(samples) > 5, samples)


def test_vrpn_client_leaves_a_server_of_another_kind(connect):
    with socket.create_server((LOOPBACK, 0)) as listener:
        port = listener.getsockname()[1]
        receiver = connect(f"vrpn://{LOOPBACK}:{port}/car")
        receiver.on_timer(0)
        peer, _ = listener.accept()
        with peer:
            peer.sendall(b"220 mail.example ESMTP ready, go ahead\r\n")
            drive(receiver, lambda: None, lambda: not receiver.fds(), [])
            assert "not a VRPN 7 server" in receiver.status().detail


def test_vrpn_without_a_server_backs_off(connect):
    port = free_port()
    receiver = connect(f"vrpn://{LOOPBACK}:{port}/car")
    assert isinstance(receiver, VrpnReceiver)
    attempts = []
    for i in range(2000):
        t = i * 10 * MS
        before = receiver._due
        receiver.on_timer(t)
        if receiver._due != before:
            attempts.append(t // MS)
    gaps = [b - a for a, b in pairwise(attempts)]
    assert gaps[:5] == [500, 1000, 2000, 4000, 5000]
    assert "refused" in receiver.status().detail


@pytest.mark.parametrize("udp_server", [False], indirect=True)
def test_the_kernel_stamps_udp_and_tcp(udp_server, tcp_server, connect):
    """A receiver that reads late must still know when the datagram came."""
    offset = [0]
    clock = SimpleNamespace(
        now_ns=lambda: time.monotonic_ns() + offset[0],
        realtime_ns=lambda: time.time_ns() + offset[0],
    )
    for server in (udp_server, tcp_server):
        offset[0] = 0
        receiver, _ = follow(connect, server, clock=clock)
        server.begun_ns -= 20 * MS
        server.pump()
        sent_by = time.monotonic_ns()
        ready, _, _ = select.select(receiver.fds(), [], [], 1.0)
        offset[0] = 100 * MS  # as if the interpreter had been busy for 100 ms
        late = [s for fd in ready for s in receiver.read_ready(fd)]
        assert late
        assert all(s.t_arrival_ns < sent_by + 5 * MS for s in late)


def make_ancillary(stamp_ns):
    return [(socket.SOL_SOCKET, 35, struct.pack("qq", *divmod(stamp_ns, SECOND)))]


def test_map_stamp():
    real = 1_700_000_000 * SECOND
    assert map_stamp(make_ancillary(real - 3 * MS), 50 * SECOND, real) == 50 * SECOND - 3 * MS
    assert map_stamp(make_ancillary(real + 1), 50 * SECOND, real) is None  # clock stepped back
    assert map_stamp(make_ancillary(real - 201 * MS), 50 * SECOND, real) is None
    assert map_stamp([], 50 * SECOND, real) is None


def fail_to_resolve(*_):
    raise socket.gaierror(-2, "Name or service not known")


def test_addresses_that_make_no_receiver(monkeypatch):
    with pytest.raises(ValueError, match="over the bus"):
        make_receiver(parse_mocap_url("zenoh:lab/pose"), CONFIG)
    monkeypatch.setattr(socket, "getaddrinfo", fail_to_resolve)
    with pytest.raises(OSError, match=r"'no.such.host' does not resolve"):
        make_receiver(parse_mocap_url("vrpn://no.such.host/car"), CONFIG)
    z_forward = IngestConfig(frame=FrameConfig(up="y", body_forward="+z"))
    monkeypatch.undo()
    with pytest.raises(ValueError, match="up axis"):
        make_receiver(parse_mocap_url("vrpn://127.0.0.1/car?up=z"), z_forward)
