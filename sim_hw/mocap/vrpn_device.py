"""The simulated VRPN server: one `mocap_link` session per connection, fed by the cameras."""

from steerd.mocap_link.vrpn import VrpnError
from steerd.mocap_link.vrpn_server import VrpnServer
from steerd.sim_hw.mocap.cameras import Capture
from steerd.sim_hw.mocap.mocap_config import MocapConfig
from steerd.sim_hw.mocap.network import CLOSE, STREAM, Datagram, Network, Peer
from steerd.sim_hw.plant.fault_state import HEALTHY_MOCAP, MocapFaultState
from steerd.sim_hw.plant.noise import NoiseSource

_ANSWER_NS = 100_000


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
