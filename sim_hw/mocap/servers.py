"""The simulated mocap servers: NatNet with sessions, echoes and frames, VRPN by connection.

The wires are `mocap_link`'s.
"""

from steerd.mocap_link import natnet, vrpn
from steerd.mocap_link import natnet_wire as wire
from steerd.mocap_link.frame import Quat, Vec3
from steerd.mocap_link.source import Pose
from steerd.mocap_link.vrpn import VrpnError
from steerd.sim_hw.mocap import network as net
from steerd.sim_hw.mocap.cameras import Capture, MocapConfig
from steerd.sim_hw.plant.faults import HEALTHY_MOCAP, MocapFaultState
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.steer_bus.quick_values import changed

_NS = 1_000_000_000
_APP_VERSION = (3, 1, 0, 0)
_ANSWER_NS = 150_000
_ANOTHER = natnet.RigidBodyDesc("newcomer", 9)  # enters the model list when it changes


class _Server:
    """What both servers have: a condition, and a clock of ``hz`` ticks that runs a little fast."""

    def __init__(
        self, config: MocapConfig, network: net.Network, noise: NoiseSource, t_ns: int, hz: int
    ) -> None:
        self.config, self._network, self._noise = config, network, noise
        self.fault_state: MocapFaultState = HEALTHY_MOCAP  # what is wrong with it
        self._hz, self._epoch_ns, self._epoch_ticks = hz, t_ns, config.epoch_ticks

    def set_fault_state(self, t_ns: int, faults: MocapFaultState) -> None:
        """From ``t_ns`` on, be in this condition."""
        before, self.fault_state = self.fault_state, faults
        if faults.restart and not before.restart:
            self._epoch_ns, self._epoch_ticks = t_ns, self._hz  # up for one second

    def ticks(self, t_ns: int) -> int:
        """The server's clock."""
        elapsed = t_ns - self._epoch_ns + self.fault_state.clock_step_ns
        skew = int(elapsed * self.config.skew_ppm * 1e-6 * self._hz / _NS)
        return self._epoch_ticks + elapsed * self._hz // _NS + skew


class NatNetServer(_Server):
    """One server. `on_message` takes datagrams of the command socket, `publish` sends frames."""

    def __init__(
        self, config: MocapConfig, network: net.Network, noise: NoiseSource, t_ns: int
    ) -> None:
        super().__init__(config, network, noise, t_ns, config.clock_hz)
        # Sent to clients in SERVERINFO; `links` sets the one it really uses
        self.data_port = natnet.DATA_PORT
        others = (natnet.RigidBodyDesc(b.name, b.id) for b in config.bystanders)
        self._bodies = natnet.RigidBodyDesc(config.body, config.body_id), *others
        self._clients: dict[net.Peer, int] = {}
        self._model_flag = False
        self._grown = False

    def set_fault_state(self, t_ns: int, faults: MocapFaultState) -> None:
        """From ``t_ns`` on, be in this condition."""
        if faults.restart and not self.fault_state.restart:
            self._clients.clear()
        if faults.model_changed and not self.fault_state.model_changed:
            self._model_flag = self._grown = True
        super().set_fault_state(t_ns, faults)

    # --- session

    def on_message(self, t_ns: int, data: bytes, peer: net.Peer) -> None:
        """Take a datagram from a client; nonsense is dropped as a real server does."""
        try:
            message = natnet.decode(data, self.config.version)
        except wire.NatNetError:
            return
        if message is natnet.Bare.DISCONNECT:
            self._clients.pop(peer, None)
            return
        self._clients[peer] = t_ns
        answer = self._answer(t_ns, message)
        if answer is not None and not self.fault_state.silent:
            data = natnet.encode(answer, self.config.version)
            self._network.send(net.Datagram(t_ns + _ANSWER_NS, net.COMMAND, data, peer))

    def _answer(self, t_ns: int, message: natnet.Message) -> natnet.Message | None:
        match message:
            case natnet.Bare.CONNECT | natnet.Bare.DISCOVERY:
                return self._info()
            case natnet.EchoRequest():
                return natnet.EchoResponse(message.client_stamp, self.ticks(t_ns + _ANSWER_NS // 2))
            case natnet.Bare.REQUEST_MODEL:
                self._model_flag = False
                return self._model()
            case natnet.Request():
                known = message.text.split(",")[0] == "FrameRate"
                rate = natnet.Response(wire.F32.pack(self.config.rate_hz))
                return rate if known else natnet.Unrecognized(100)
        return None

    def _info(self) -> natnet.ServerInfo:
        config = self.config
        about = (*config.version, 0, 0), config.clock_hz, self.data_port, config.multicast
        return natnet.ServerInfo("steerd simulated Motive", _APP_VERSION, *about)

    def _model(self) -> natnet.ModelDef:
        return natnet.ModelDef((*self._bodies, *((_ANOTHER,) if self._grown else ())))

    # --- frames

    def publish(self, capture: Capture) -> None:
        """Send a frame for an exposure."""
        config = self.config
        received = capture.t_ns + config.camera_ns
        sent = received + config.software_ns
        sent += max(0, round(config.jitter_ns * self._noise.normal()))
        destinations = self._destinations(capture.t_ns)
        if not destinations:
            return
        data = natnet.encode(self._frame(capture, received, sent), config.version)
        arrival = sent + config.network_ns
        for channel, peer in destinations:
            self._network.send_frame(net.Datagram(arrival, channel, data, peer))
            if self.fault_state.foreign:
                data = natnet.encode(self._frame(self._forge(capture), received, sent))
                self._network.send(net.Datagram(arrival, net.FOREIGN, data, peer))

    def _destinations(self, t_ns: int) -> list[tuple[str, net.Peer | None]]:
        if self.config.multicast:
            return [(net.DATA, None)]
        oldest = t_ns - self.config.keepalive_ns
        self._clients = {peer: t for peer, t in self._clients.items() if t >= oldest}
        return [(net.COMMAND, peer) for peer in self._clients]

    def _frame(self, capture: Capture, received_ns: int, sent_ns: int) -> wire.Frame:
        faults = self.fault_state
        params = wire.MODEL_CHANGED if self._model_flag else 0
        params |= wire.EDIT_MODE if faults.edit_mode else 0
        return wire.Frame(
            capture.number,
            tuple(map(_rigid_body, self._bodies[-len(capture.bodies) :], capture.bodies)),
            timestamp=capture.number / self.config.rate_hz,
            mid_exposure_ticks=self.ticks(capture.t_ns),
            data_received_ticks=self.ticks(received_ns),
            transmit_ticks=self.ticks(sent_ns),
            params=params,
        )

    def _forge(self, capture: Capture) -> Capture:
        """The same frame with everything somewhere else."""
        far = self.fault_state.foreign
        bodies = tuple(
            changed(body, position=(body.position[0] + far, *body.position[1:]))
            for body in capture.bodies
        )
        return changed(capture, bodies=bodies)


def _rigid_body(known: natnet.RigidBodyDesc, body: Pose) -> wire.RigidBody:
    w, x, y, z = body.quaternion
    state = body.mean_error or 0.0, int(body.tracking_valid) * wire.TRACKING_VALID
    return wire.RigidBody(known.id, body.position, (x, y, z, w), *state)


_VRPN_ANSWER_NS = 100_000
_TYPES = (vrpn.POSE_TYPE, vrpn.PING_TYPE, vrpn.PONG_TYPE)
_POSE_ID, _PONG_ID = 0, 2


class VrpnServer:
    """One connection's server: greets, names its bodies, answers pings, encodes poses.

    Feed what arrives into `receive`, send what it and the other methods return.
    """

    def __init__(self, bodies: tuple[str, ...]) -> None:
        self.bodies = bodies
        self._stream = vrpn.Stream()
        self._peer_types: dict[int, str] = {}
        self._sequence = 0

    def hello(self) -> bytes:
        """Return what to send as soon as a client connects."""
        named = ((vrpn.TYPE_DESCRIPTION, _TYPES), (vrpn.SENDER_DESCRIPTION, self.bodies))
        return vrpn.COOKIE + b"".join(
            vrpn.encode(vrpn.make_description(kind, number, name))
            for kind, names in named
            for number, name in enumerate(names)
        )

    def pose(self, body: str, stamp_us: int, position: Vec3, quaternion: Quat) -> bytes:
        """Encode one pose [m, (w, x, y, z)]; `stamp_us` is on the server's clock."""
        w, x, y, z = quaternion
        payload = vrpn.write_pose(0, (position, (x, y, z, w)))
        return self._message(_POSE_ID, self.bodies.index(body), stamp_us, payload)

    def receive(self, data: bytes, stamp_us: int) -> bytes:
        """Take in bytes from the client; returns the answers.

        Raises:
            VrpnError: the peer does not speak VRPN; close the connection.
        """
        return b"".join(self._answer(message, stamp_us) for message in self._stream.feed(data))

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


class VrpnDevice(_Server):
    """A VRPN server for any number of clients; its clock counts microseconds.

    VRPN has no tracking-valid flag: a body that is not tracked is not sent.
    """

    def __init__(
        self, config: MocapConfig, network: net.Network, noise: NoiseSource, t_ns: int
    ) -> None:
        super().__init__(config, network, noise, t_ns, 1_000_000)
        self._names = (config.body, *(b.name for b in config.bystanders))
        self._sessions: dict[net.Peer, VrpnServer] = {}
        self._deserted: set[net.Peer] = set()

    def set_fault_state(self, t_ns: int, faults: MocapFaultState) -> None:
        """From ``t_ns`` on, be in this condition."""
        if faults.restart and not self.fault_state.restart:
            for peer in tuple(self._sessions):
                self.on_disconnect(peer)
                self._network.send(net.Datagram(t_ns, net.CLOSE, b"", peer))
        if faults.half_open and not self.fault_state.half_open:
            self._deserted.update(self._sessions)
        super().set_fault_state(t_ns, faults)

    def on_connect(self, t_ns: int, peer: net.Peer) -> None:
        """A client has connected."""
        session = self._sessions[peer] = VrpnServer(self._names)
        self._network.send(net.Datagram(t_ns + _VRPN_ANSWER_NS, net.STREAM, session.hello(), peer))

    def on_disconnect(self, peer: net.Peer) -> None:
        """A client is gone."""
        self._sessions.pop(peer, None)
        self._deserted.discard(peer)
        self._network.forget(peer)

    def on_message(self, t_ns: int, data: bytes, peer: net.Peer) -> None:
        """Take bytes from a client; one that does not speak VRPN is hung up on."""
        session = self._sessions.get(peer)
        if session is None or peer in self._deserted:
            return
        try:
            answer = session.receive(data, self.ticks(t_ns))
        except VrpnError:
            self.on_disconnect(peer)
            self._network.send(net.Datagram(t_ns, net.CLOSE, b"", peer))
            return
        if answer and not self.fault_state.silent:
            self._network.send(net.Datagram(t_ns + _VRPN_ANSWER_NS, net.STREAM, answer, peer))

    def publish(self, capture: Capture) -> None:
        """Send the poses of an exposure to every client."""
        config = self.config
        late = config.camera_ns + config.software_ns + config.network_ns
        late += max(0, round(config.jitter_ns * self._noise.normal()))
        stamp = self.ticks(capture.t_ns)
        for peer, session in self._sessions.items():
            if peer in self._deserted:
                continue
            data = b"".join(
                session.pose(body.body, stamp, body.position, body.quaternion)
                for body in capture.bodies
                if body.tracking_valid
            )
            if data:
                self._network.send_frame(net.Datagram(capture.t_ns + late, net.STREAM, data, peer))


MocapServer = NatNetServer | VrpnDevice
