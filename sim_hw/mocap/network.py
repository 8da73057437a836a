"""The network from mocap server to host: latency, loss, order and foreign senders."""

import heapq

from steerd.sim_hw.plant.faults import HEALTHY_MOCAP, MocapFaultState
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.steer_bus.quick_values import changed, quick_value

Peer = int | tuple[str, int]
"""Who a message goes to or comes from: a number in virtual time, an address on sockets."""

COMMAND, DATA, STREAM, FOREIGN, CLOSE = "command", "data", "stream", "foreign", "close"
"""Channels: NatNet's two sockets, a VRPN connection, another sender, a connection's end."""

_OVERSIZED = 4096


@quick_value
class Datagram:
    """A message at the time at which it reaches the host [ns]; peer None means everyone."""

    t_ns: int
    channel: str
    data: bytes
    peer: Peer | None = None


class Network:
    """Messages in flight, by time of arrival."""

    def __init__(self, noise: NoiseSource) -> None:
        self.fault_state: MocapFaultState = HEALTHY_MOCAP  # what is wrong with it
        self._noise = noise
        self._heap: list[tuple[int, int, Datagram]] = []
        self._count = 0
        self._last: Datagram | None = None
        self._waiting: Datagram | None = None
        self.next_ns: int | None = None  # when the next message arrives; None without any

    def send(self, message: Datagram) -> None:
        """Send something that no fault touches (answers, descriptions)."""
        self._count += 1
        heapq.heappush(self._heap, (message.t_ns, self._count, message))
        self.next_ns = self._heap[0][0]

    def send_frame(self, frame: Datagram) -> None:
        """Send a frame through whatever is wrong."""
        faults = self.fault_state
        if faults is HEALTHY_MOCAP:
            self.send(frame)
            self._last = frame
            return
        if self._is_lost(frame.t_ns):
            return
        late = faults.latency_ns
        if faults.jitter_ns:
            late += int(faults.jitter_ns * self._noise.uniform())
        if faults.resend and self._last is not None:
            frame = changed(frame, data=self._last.data)
        self._last = frame
        frame = changed(frame, t_ns=frame.t_ns + late)
        if faults.reorder:
            self._send_swapped(frame)
        else:
            self.send(frame)
        if faults.duplicate:
            self.send(frame)
        if faults.noise:
            self.send(changed(frame, data=self._nonsense(frame.data)))

    def _is_lost(self, t_ns: int) -> bool:
        faults = self.fault_state
        if faults.gap_ns and (t_ns - faults.since_ns) % faults.gap_every_ns < faults.gap_ns:
            return True
        return faults.silent or self._noise.chance(faults.loss)

    def _send_swapped(self, frame: Datagram) -> None:
        if self._waiting is None:
            self._waiting = frame
            return
        self.send(frame)
        self.send(changed(self._waiting, t_ns=frame.t_ns))
        self._waiting = None

    def _nonsense(self, data: bytes) -> bytes:
        match self.fault_state.noise:
            case "truncated":
                return data[: 1 + int(self._noise.uniform() * (len(data) - 1))]
            case "oversized":
                return data + self._noise.random_bytes(_OVERSIZED)
        return self._noise.random_bytes(1 + int(self._noise.uniform() * 200))

    def due(self, t_ns: int) -> list[Datagram]:
        """Take out what has arrived by ``t_ns``."""
        heap, out = self._heap, []
        while heap and heap[0][0] <= t_ns:
            out.append(heapq.heappop(heap)[2])
        self.next_ns = heap[0][0] if heap else None
        return out

    def forget(self, peer: Peer) -> None:
        """Lose what is in flight to one peer."""
        self._heap = [entry for entry in self._heap if entry[2].peer != peer]
        heapq.heapify(self._heap)
        self.next_ns = self._heap[0][0] if self._heap else None
