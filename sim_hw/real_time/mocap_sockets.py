"""The simulated mocap server's sockets: NatNet over UDP, VRPN over TCP, all on the loopback."""

import contextlib
import socket

from steerd.mocap_link.natnet import MULTICAST_GROUP
from steerd.sim_hw.mocap.cameras import MocapConfig
from steerd.sim_hw.mocap.network import CLOSE, COMMAND, DATA, FOREIGN, STREAM, Datagram
from steerd.sim_hw.mocap.servers import NatNetServer, VrpnDevice
from steerd.sim_hw.world import World

_HOST = "127.0.0.1"
_STRANGER = "127.0.0.9"
_READ = 65_536


def _udp(host: str, port: int) -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind((host, port))
    udp.setblocking(False)
    return udp


def _url(scheme: str, near: socket.socket, config: MocapConfig) -> str:
    port = int(near.getsockname()[1])
    return f"{scheme}://{_HOST}:{port}/{config.body}?up={config.frame.up}"


class NatNetSockets:
    """Command socket of a NatNet server, which also sends the frames, and a stranger's socket."""

    def __init__(self, server: NatNetServer) -> None:
        self._command = _udp(_HOST, 0)
        self._command.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(_HOST))
        self._command.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        self._stranger: socket.socket | None = None
        with _udp(_HOST, 0) as free:
            self.data_port = server.data_port = int(free.getsockname()[1])
        how = f"interface={_HOST}" if server.config.multicast else "unicast=1"
        self.url = _url("natnet", self._command, server.config) + f"&{how}"

    def read_fds(self) -> tuple[int, ...]:
        """What to poll."""
        return (self._command.fileno(),)

    def pump(self, world: World, t_ns: int) -> None:
        """Move datagrams both ways."""
        with contextlib.suppress(BlockingIOError):
            while True:
                data, address = self._command.recvfrom(_READ)
                world.mocap_write(t_ns, data, COMMAND, (address[0], address[1]))
        for message in world.mocap_read(t_ns):
            self._send(message)

    def _send(self, message: Datagram) -> None:
        peer, sender = message.peer, self._command
        host, port = peer if isinstance(peer, tuple) else (MULTICAST_GROUP, self.data_port)
        if message.channel == DATA:
            port = self.data_port
        if message.channel == FOREIGN:
            sender = self._stranger = self._stranger or _udp(_STRANGER, 0)
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            sender.sendto(message.data, (host, port))

    def close(self) -> None:
        """Close all sockets."""
        self._command.close()
        if self._stranger is not None:
            self._stranger.close()


class VrpnSockets:
    """Listening socket of a VRPN server and its connections."""

    def __init__(self, server: VrpnDevice) -> None:
        self._server = server
        self._listener = socket.create_server((_HOST, 0))
        self._listener.setblocking(False)
        self.url = _url("vrpn", self._listener, server.config)
        self._clients: dict[tuple[str, int], socket.socket] = {}

    def read_fds(self) -> tuple[int, ...]:
        """What to poll."""
        return (self._listener.fileno(), *(c.fileno() for c in self._clients.values()))

    def pump(self, world: World, t_ns: int) -> None:
        """Accept, move bytes both ways, hang up."""
        world.advance(t_ns)
        with contextlib.suppress(BlockingIOError):
            while True:
                client, address = self._listener.accept()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients[address] = client
                self._server.on_connect(t_ns, address)
        for peer in tuple(self._clients):
            self._receive(world, t_ns, peer)
        for message in world.mocap_read(t_ns):
            self._send(message)

    def _receive(self, world: World, t_ns: int, peer: tuple[str, int]) -> None:
        try:
            data = self._clients[peer].recv(_READ)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            world.mocap_write(t_ns, data, STREAM, peer)
        else:
            self._drop(peer)

    def _send(self, message: Datagram) -> None:
        peer = message.peer
        if not isinstance(peer, tuple) or peer not in self._clients:
            return
        if message.channel == CLOSE:
            self._drop(peer)
            return
        try:
            self._clients[peer].sendall(message.data)
        except OSError:  # a client that does not read, or is gone
            self._drop(peer)

    def _drop(self, peer: tuple[str, int]) -> None:
        self._clients.pop(peer).close()
        self._server.on_disconnect(peer)

    def close(self) -> None:
        """Close all sockets."""
        self._listener.close()
        for client in self._clients.values():
            client.close()
        self._clients.clear()


MocapSockets = NatNetSockets | VrpnSockets  # the open ends of a mocap server
