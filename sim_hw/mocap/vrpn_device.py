"""The simulated VRPN server: a session for each connection, fed by the cameras."""

from steerd.mocap_link import vrpn
from steerd.mocap_link.vrpn import VrpnError
from steerd.sim_hw.mocap.cameras import Capture
from steerd.sim_hw.mocap.mocap_config import MocapConfig
from steerd.sim_hw.mocap.network import CLOSE, STREAM, Datagram, Network, Peer
from steerd.sim_hw.plant.fault_state import HEALTHY_MOCAP, MocapFaultState
from steerd.sim_hw.plant.noise import NoiseSource

_ANSWER_NS = 100_000
_TYPES = (vrpn.POSE_TYPE, vrpn.PING_TYPE, vrpn.PONG_TYPE)
_POSE_ID, _PONG_ID = 0, 2


class VrpnServer:
    """One connection's server: greets, names its bodies, answers pings, encodes poses.

    Feed what arrives into `receive`, send what it and the other methods return.

    Args:
        bodies: names of the bodies; more may come with `add_body`.
    """

    def __init__(self, bodies: tuple[str, ...]) -> None:
        self._bodies: list[str] = []
        self._buffer = bytearray()
        self._greeted = False
        self._peer_types: dict[int, str] = {}
        self._sequence = 0
        self._hello = vrpn.encode_cookie() + b"".join(
            vrpn.encode(vrpn.make_description(vrpn.TYPE_DESCRIPTION, i, name))
            for i, name in enumerate(_TYPES)
        )
        self._hello += b"".join(self.add_body(body) for body in bodies)

    def hello(self) -> bytes:
        """Return what to send as soon as a client connects."""
        return self._hello

    def add_body(self, name: str) -> bytes:
        """Enable another body, at any time; returns its description."""
        self._bodies.append(name)
        sender = len(self._bodies) - 1
        return vrpn.encode(vrpn.make_description(vrpn.SENDER_DESCRIPTION, sender, name))

    def pose(
        self,
        body: str,
        stamp_us: int,
        position: tuple[float, float, float],
        quaternion_wxyz: tuple[float, float, float, float],
    ) -> bytes:
        """Encode one pose [m]; `stamp_us` is on the server's clock."""
        w, x, y, z = quaternion_wxyz
        payload = vrpn.write_pose(0, (position, (x, y, z, w)))
        return self._message(_POSE_ID, self._bodies.index(body), stamp_us, payload)

    def receive(self, data: bytes, stamp_us: int) -> bytes:
        """Take in bytes from the client; returns the answers.

        Raises:
            VrpnError: the peer does not speak VRPN; close the connection.
        """
        self._buffer += data
        if not self._greeted:
            if len(self._buffer) < vrpn.COOKIE_SIZE:
                return b""
            vrpn.check_cookie(bytes(self._buffer[: vrpn.COOKIE_SIZE]))
            del self._buffer[: vrpn.COOKIE_SIZE]
            self._greeted = True
        messages, used = vrpn.decode_stream(self._buffer)
        del self._buffer[:used]
        return b"".join(self._answer(message, stamp_us) for message in messages)

    def _answer(self, message: vrpn.Message, stamp_us: int) -> bytes:
        if message.type == vrpn.TYPE_DESCRIPTION:
            self._peer_types[message.sender] = vrpn.read_description(message.payload)
        elif self._peer_types.get(message.type) == vrpn.PING_TYPE:
            return self._message(_PONG_ID, 0, stamp_us, b"")
        return b""

    def _message(self, kind: int, sender: int, stamp_us: int, payload: bytes) -> bytes:
        self._sequence += 1
        sec, usec = divmod(stamp_us, 1_000_000)
        return vrpn.encode(vrpn.Message(kind, sender, sec, usec, payload, self._sequence))


class VrpnDevice:
    """A VRPN server for any number of clients.

    VRPN has no tracking-valid flag: a body that is not tracked is not sent.

    Attributes:
        fault_state: what is wrong with it.
    """

    def __init__(
        self, config: MocapConfig, network: Network, noise: NoiseSource, t_ns: int
    ) -> None:
        self.config = config
        self.fault_state: MocapFaultState = HEALTHY_MOCAP
        self._network = network
        self._noise = noise
        self._epoch_ns = t_ns
        self._epoch_us = config.epoch_ticks
        self._names = (config.body, *(b.name for b in config.bystanders))
        self._sessions: dict[Peer, VrpnServer] = {}
        self._deserted: set[Peer] = set()

    def set_fault_state(self, t_ns: int, faults: MocapFaultState) -> None:
        """From ``t_ns`` on, be in this condition."""
        before, self.fault_state = self.fault_state, faults
        if faults.restart and not before.restart:
            self._epoch_ns, self._epoch_us = t_ns, 1_000_000
            for peer in tuple(self._sessions):
                self.on_disconnect(peer)
                self._network.send(Datagram(t_ns, CLOSE, b"", peer))
        if faults.half_open and not before.half_open:
            self._deserted.update(self._sessions)

    def stamp_us(self, t_ns: int) -> int:
        """The server's clock [us]."""
        elapsed = t_ns - self._epoch_ns + self.fault_state.clock_step_ns
        return self._epoch_us + int(elapsed * (1.0 + self.config.skew_ppm * 1e-6)) // 1000

    def on_connect(self, t_ns: int, peer: Peer) -> None:
        """A client has connected."""
        session = self._sessions[peer] = VrpnServer(self._names)
        self._network.send(Datagram(t_ns + _ANSWER_NS, STREAM, session.hello(), peer))

    def on_disconnect(self, peer: Peer) -> None:
        """A client is gone."""
        self._sessions.pop(peer, None)
        self._deserted.discard(peer)
        self._network.forget(peer)

    def on_message(self, t_ns: int, data: bytes, peer: Peer) -> None:
        """Take bytes from a client; one that does not speak VRPN is hung up on."""
        session = self._sessions.get(peer)
        if session is None or peer in self._deserted:
            return
        try:
            answer = session.receive(data, self.stamp_us(t_ns))
        except VrpnError:
            self.on_disconnect(peer)
            self._network.send(Datagram(t_ns, CLOSE, b"", peer))
            return
        if answer and not self.fault_state.silent:
            self._network.send(Datagram(t_ns + _ANSWER_NS, STREAM, answer, peer))

    def publish(self, capture: Capture) -> None:
        """Send the poses of an exposure to every client."""
        config = self.config
        late = config.camera_ns + config.software_ns + config.network_ns
        late += max(0, round(config.jitter_ns * self._noise.normal()))
        stamp = self.stamp_us(capture.t_ns)
        for peer, session in self._sessions.items():
            if peer in self._deserted:
                continue
            data = b"".join(
                session.pose(body.name, stamp, body.position, body.quaternion)
                for body in capture.bodies
                if body.valid
            )
            if data:
                self._network.send_frame(Datagram(capture.t_ns + late, STREAM, data, peer))
