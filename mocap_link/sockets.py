"""Sockets under the sources: non-blocking, kernel-stamped, polled by someone else's loop.

A busy interpreter stamps a datagram milliseconds late; the kernel stamps it at reception
(SO_TIMESTAMPNS, for UDP and TCP). Names are resolved once, when a receiver is made; nothing
blocks afterwards.
"""

import contextlib
import errno
import os
import socket
import struct
from dataclasses import replace

from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import MocapUrl
from steerd.mocap_link.natnet import FRAME_ID, ServerInfo, peek_id
from steerd.mocap_link.natnet_client import NatNetSource, Socket
from steerd.mocap_link.source import Pose, SourceStatus
from steerd.mocap_link.vrpn_client import VrpnSource
from steerd.steer_bus.clock import Clock, MonotonicClock

SECOND = 1_000_000_000
STAMP_AGE_MAX_NS = SECOND // 5
BACKLOG_MAX = 5

_SO_TIMESTAMPNS = 35  # no constant in Python 3.11; asm-generic, so x86 and ARM alike
_STAMP = struct.Struct("qq")
_DRAIN_MAX = 256
_RCVBUF = 1 << 20


def make_receiver(
    url: MocapUrl, config: IngestConfig, *, clock: Clock | None = None
) -> "MocapReceiver":
    """Make the receiver that an address asks for; blocks while the host name is resolved.

    The address's `up` goes before the configuration's.

    Raises:
        ValueError: a zenoh address (feed `zenoh_pose.make_bus_source` from the bus), or an up axis
            that contradicts the body's forward axis.
        OSError: the host name does not resolve, or no socket can be made.
    """
    config = replace(config, frame=url.apply(config.frame))
    clock = clock or MonotonicClock()
    if url.scheme == "natnet":
        ip = resolve(url.host)
        source = NatNetSource(url.body, ip, config, unicast=url.unicast)
        return NatNetReceiver(source, url.port, clock, interface=url.interface)
    if url.scheme == "vrpn":
        vrpn = VrpnSource(url.body, config)
        return VrpnReceiver(vrpn, (resolve(url.host), url.port), clock)
    raise ValueError(f"{url.scheme} poses come over the bus, not over a socket")


def resolve(host: str) -> str:
    """Return the IPv4 address of a host.

    Raises:
        OSError: it has none.
    """
    try:
        found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise OSError(f"mocap host {host!r} does not resolve: {error}") from error
    return str(found[0][4][0])


def derive_interface(server_ip: str, port: int) -> str:
    """Return the local address from which the server is reached (a route lookup; sends nothing).

    Raises:
        OSError: no route.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((server_ip, port))
        return str(probe.getsockname()[0])


def map_stamp(
    ancillary: list[tuple[int, int, bytes]], monotonic_ns: int, realtime_ns: int
) -> int | None:
    """Map a kernel receive stamp to CLOCK_MONOTONIC.

    t = mono_now - (real_now - stamp), unless the age falls outside [0, 200 ms]: then CLOCK_REALTIME
    was stepped in between, and None is returned.
    """
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) == _STAMP.size:
            sec, ns = _STAMP.unpack(data)
            age = realtime_ns - (sec * SECOND + ns)
            return monotonic_ns - age if 0 <= age <= STAMP_AGE_MAX_NS else None
    return None


def _receive(
    sock: socket.socket, size: int, clock: Clock
) -> tuple[bytes, int, tuple[str, int]] | None:
    """Read once: data, arrival time and sender; None when there is nothing."""
    try:
        data, ancillary, _, sender = sock.recvmsg(size, 128)
    except (BlockingIOError, InterruptedError):
        return None
    monotonic_ns = clock.now_ns()
    stamp = map_stamp(ancillary, monotonic_ns, clock.realtime_ns())
    return data, monotonic_ns if stamp is None else stamp, sender or ("", 0)


def _make_socket(kind: socket.SocketKind) -> socket.socket:
    sock = socket.socket(socket.AF_INET, kind)
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RCVBUF)
    return sock


class NatNetReceiver:
    """NatNet over UDP: a command socket, and a data socket once the server named its port.

    Frames are taken from either. If more than 5 are queued, the oldest are dropped.
    """

    data_retry_ns = SECOND

    def __init__(
        self, source: NatNetSource, port: int, clock: Clock, *, interface: str | None = None
    ) -> None:
        self.source, self.ingest = source, source.ingest
        self._server = (source.server_ip, port)
        self._clock = clock
        self.interface = interface or derive_interface(*self._server)
        self._command = _make_socket(socket.SOCK_DGRAM)
        self._command.bind((self.interface, 0))
        self._data: socket.socket | None = None
        self._data_for: tuple[int, str, bool] | None = None
        self._data_due = 0
        self._data_error = ""

    def fds(self) -> list[int]:
        """Return the descriptors to poll for reading: the command socket's first."""
        return [s.fileno() for s in (self._command, self._data) if s is not None]

    def read_ready(self, fd: int) -> list[Pose]:
        """Drain one socket, in order."""
        if self._data is not None and fd == self._data.fileno():
            return self._read(self._data, "data")
        return self._read(self._command, "command") if fd == self._command.fileno() else []

    def _read(self, sock: socket.socket, which: Socket) -> list[Pose]:
        queue: list[tuple[bytes, int, str]] = []
        for _ in range(_DRAIN_MAX):
            try:
                got = _receive(sock, 65_535, self._clock)
            except OSError:  # a queued ICMP error: the port was closed when we sent
                continue
            if got is None:
                break
            queue.append((got[0], got[1], got[2][0]))
        if len(queue) > BACKLOG_MAX:
            queue = self._drop_backlog(queue)
        samples: list[Pose] = []
        for data, t_ns, ip in queue:
            samples += self.source.on_datagram(data, t_ns, ip, which)
        return samples

    def _drop_backlog(self, queue: list[tuple[bytes, int, str]]) -> list[tuple[bytes, int, str]]:
        server = self._server[0]
        frames = [
            i for i, (data, _, ip) in enumerate(queue) if ip == server and peek_id(data) == FRAME_ID
        ]
        old = set(frames[:-BACKLOG_MAX])
        return [item for i, item in enumerate(queue) if i not in old]

    def on_timer(self, t_ns: int) -> None:
        """Send what the session wants; open the data socket when the server named its port."""
        for datagram in self.source.on_timer(t_ns):
            with contextlib.suppress(OSError):  # the session sends again, with backoff
                self._command.sendto(datagram, self._server)
        info = self.source.info
        if info is not None:
            self._follow(info, t_ns)

    def _follow(self, info: ServerInfo, t_ns: int) -> None:
        want = (info.data_port, info.group, self.source.unicast)
        if want == self._data_for or t_ns < self._data_due:
            return
        if self._data is not None:
            self._data.close()
            self._data = None
        try:
            self._data = self._open_data(*want)
        except OSError as error:
            # no reason to stop in unicast, where frames may come to the command socket
            self._data_due = t_ns + self.data_retry_ns
            self._data_error = f"data port {want[0]} on {self.interface}: {error.strerror}"
        else:
            self._data_for, self._data_error = want, ""

    def _open_data(self, port: int, group: str, unicast: bool) -> socket.socket:
        sock = _make_socket(socket.SOCK_DGRAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if unicast:
                sock.bind((self.interface, port))
            else:
                sock.bind((group, port))
                member = socket.inet_aton(group) + socket.inet_aton(self.interface)
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError:
            sock.close()
            raise
        return sock

    def status(self) -> SourceStatus:
        """Describe the source now."""
        status = self.source.status()
        detail = f"{status.detail}; {self._data_error}" if self._data_error else status.detail
        return replace(status, detail=detail)

    def close(self) -> None:
        """Close the sockets."""
        self._command.close()
        if self._data is not None:
            self._data.close()
            self._data = None


class VrpnReceiver:
    """VRPN over TCP: connects without blocking, and again with backoff when the server is gone."""

    connect_timeout_ns = 2 * SECOND
    retry_first_ns = SECOND // 2
    retry_last_ns = 5 * SECOND

    def __init__(self, source: VrpnSource, server: tuple[str, int], clock: Clock) -> None:
        self.source, self.ingest, self.status = source, source.ingest, source.status
        self._server = server
        self._clock = clock
        self._sock: socket.socket | None = None
        self._out = bytearray()
        self._due = self._deadline = 0
        self._retry_ns = self.retry_first_ns

    def fds(self) -> list[int]:
        """Return the descriptor to poll for reading, if there is a connection."""
        return [] if self._sock is None else [self._sock.fileno()]

    def read_ready(self, fd: int) -> list[Pose]:
        """Drain the connection."""
        samples: list[Pose] = []
        for _ in range(_DRAIN_MAX):
            if self._sock is None or self._sock.fileno() != fd:
                break
            try:
                got = _receive(self._sock, 65_535, self._clock)
            except OSError as error:
                self._close(f"connection failed: {error.strerror}")
                break
            if got is None:
                break
            if not got[0]:
                self._close("the server closed the connection")
                break
            if not self.source.up:
                self._out[:] = self.source.on_connect()
            samples += self.source.on_bytes(got[0], got[1])
            self._after_session()
        return samples

    def on_timer(self, t_ns: int) -> None:
        """Connect, ping, send; poses come with reads."""
        if self._sock is None:
            if t_ns >= self._due:
                self._connect(t_ns)
        elif not self.source.up:
            self._finish_connect(self._sock, t_ns)
        self._out += self.source.on_timer(t_ns)
        self._after_session()
        self._flush()

    def _connect(self, t_ns: int) -> None:
        self._deadline = t_ns + self.connect_timeout_ns
        self._due = t_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, self.retry_last_ns)
        self._sock = _make_socket(socket.SOCK_STREAM)
        self._sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        code = self._sock.connect_ex(self._server)
        if code not in (0, errno.EINPROGRESS):
            self._close(f"no connection to {self._server[0]}: {os.strerror(code)}")

    def _finish_connect(self, sock: socket.socket, t_ns: int) -> None:
        code = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            self._close(f"no connection to {self._server[0]}: {os.strerror(code)}")
            return
        try:
            sock.getpeername()
        except OSError:
            if t_ns > self._deadline:
                self._close(f"{self._server[0]} does not answer on port {self._server[1]}")
            return
        self._out[:] = self.source.on_connect()

    def _after_session(self) -> None:
        if self.source.up and self.source.dead is not None:
            self._close(self.source.dead)
        elif self.source.fed:
            self._retry_ns = self.retry_first_ns

    def _flush(self) -> None:
        if not self._out or self._sock is None or not self.source.up:
            return
        try:
            sent = self._sock.send(self._out)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._close(f"connection failed: {error.strerror}")
            return
        del self._out[:sent]

    def _close(self, why: str) -> None:
        if self._sock is not None:
            self._sock.close()
        self._sock = None
        self._out.clear()
        self.source.on_disconnect(why)

    def close(self) -> None:
        """Close the connection."""
        self._close("closed")


MocapReceiver = NatNetReceiver | VrpnReceiver
"""A mocap source with its sockets, for a single-threaded loop that polls `fds`.

`on_timer` is to be called at 50 Hz or faster, with a fresh CLOCK_MONOTONIC time.
"""
