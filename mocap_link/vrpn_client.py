"""A VRPN source without I/O: bytes and time in, poses and bytes out, over TCP connections.

Plain TCP only: the reverse connection of library clients breaks behind firewalls and containers,
and brings nothing. No subscription is needed, a server sends poses at once.
"""

from steerd.mocap_link import vrpn
from steerd.mocap_link.clock_sync import DEFAULT_EXTRA_LATENCY_NS, SourceTiming
from steerd.mocap_link.ingest import IngestConfig, PoseIngest
from steerd.mocap_link.source import Pose, SourceStatus

SECOND = 1_000_000_000
TICKS_HZ = 1_000_000
"""VRPN stamps are microseconds, on whatever clock the server has."""

_PING_ID, _PONG_ID = 0, 1


class VrpnSource:
    """A VRPN server's one body, from a byte stream to poses; survives reconnects.

    Attributes:
        ingest: the pipeline of its poses.
        up: whether a connection stands.
        fed: a pose of the body has come on it.
        dead: why it must be closed, or None.
    """

    ping_period_ns = SECOND
    half_open_ns = 3 * SECOND

    def __init__(self, body: str, config: IngestConfig) -> None:
        self.body = body
        self.ingest = PoseIngest(config, SourceTiming(TICKS_HZ, DEFAULT_EXTRA_LATENCY_NS["vrpn"]))
        self.up = False
        self._begin()
        self._detail = "connecting"

    def _begin(self) -> None:
        """What a new connection forgets of the one before."""
        self.fed = False
        self.dead: str | None = None
        self._detail = "waiting for the server's greeting"
        self._stream = vrpn.Stream()
        self._senders: dict[int, str] = {}
        self._types: dict[int, str] = {}
        self._heard_ns: int | None = None
        self._ping_due = self._sequence = 0

    @property
    def greeted(self) -> bool:
        """Whether the server's cookie came on this connection and is good."""
        return bool(self._stream.version)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names that the server gave its senders."""
        return tuple(name for name in self._senders.values() if name != vrpn.CONTROL_SENDER)

    def on_connect(self) -> bytes:
        """A TCP connection stands: begin a session; returns what to send."""
        self._begin()
        self.ingest.restart()
        self.up = True
        said = (
            (vrpn.SENDER_DESCRIPTION, 0, self.body),
            (vrpn.TYPE_DESCRIPTION, _PING_ID, vrpn.PING_TYPE),
            (vrpn.TYPE_DESCRIPTION, _PONG_ID, vrpn.PONG_TYPE),
        )
        described = (vrpn.encode(vrpn.make_description(*each)) for each in said)
        return vrpn.COOKIE + b"".join(described)

    def on_disconnect(self, why: str) -> None:
        """The TCP connection ended."""
        self.up = False
        self._detail = why

    def on_bytes(self, data: bytes, t_arrival_ns: int) -> list[Pose]:
        """Take in any piece of the server's stream, whose last byte came at ``t_arrival_ns``.

        Gives our body's poses in order, the server's stamps in microseconds as ticks; never raises.
        """
        if self.dead is not None:
            return []
        self._heard_ns, greeted = t_arrival_ns, self.greeted
        try:
            messages = self._stream.feed(data)
        except vrpn.VrpnError as error:
            self._die(str(error))
            return []
        if self.greeted and not greeted:
            self._detail = f"connected to VRPN {self._stream.version}; waiting for {self.body!r}"
        poses = (self._on_message(message, t_arrival_ns) for message in messages)
        return [self.ingest.push(pose) for pose in poses if pose is not None]

    def _on_message(self, message: vrpn.Message, t_ns: int) -> Pose | None:
        try:
            if message.type < 0:
                self._on_system(message)
                return None
            if self._types.get(message.type) != vrpn.POSE_TYPE:
                return None
            if self._senders.get(message.sender) != self.body:
                return None
            sensor, (position, (x, y, z, w)) = vrpn.read_pose(message.payload)
        except vrpn.VrpnError as error:
            self._detail = str(error)
            return None
        if sensor != 0:
            return None
        self.fed = True
        # a stamp before its own epoch is none, and no message could hold it
        stamp = message.stamp_us if message.stamp_us >= 0 else None
        return Pose(self.body, None, stamp, None, t_ns, position, (w, x, y, z))

    def _on_system(self, message: vrpn.Message) -> None:
        if message.type == vrpn.DISCONNECT:
            self._die("the server ended the session")
        elif message.type == vrpn.TYPE_DESCRIPTION:
            self._name(self._types, message)
        elif message.type == vrpn.SENDER_DESCRIPTION:
            self._name(self._senders, message)
            offered = ", ".join(self.bodies) or "none"
            if self.body in self._senders.values():
                self._detail = f"following {self.body!r}"
            else:
                self._detail = f"no body {self.body!r} on the server yet; it offers: {offered}"

    def _name(self, names: dict[int, str], message: vrpn.Message) -> None:
        if len(names) < 10_000:
            names[message.sender] = vrpn.read_description(message.payload)

    def _die(self, why: str) -> None:
        self.dead = self._detail = why

    def on_timer(self, t_ns: int) -> bytes:
        """Let time pass; returns bytes to send: a ping a second once the server greeted.

        A server that is silent for 3 s in spite of pings is gone although TCP says nothing (a
        PC that lost power); `dead` is then set.
        """
        self.ingest.on_timer(t_ns, connected=self.up and self.greeted)
        if not self.up:
            return b""
        if self._heard_ns is None:
            self._heard_ns = t_ns
        if self.dead is None and t_ns - self._heard_ns > self.half_open_ns:
            self._die("the server has been silent for 3 s")
        if self.dead is not None or not self.greeted or t_ns < self._ping_due:
            return b""
        self._ping_due = t_ns + self.ping_period_ns
        self._sequence += 1
        sec, ns = divmod(t_ns, SECOND)
        return vrpn.encode(vrpn.Message(_PING_ID, 0, sec, ns // 1000, b"", self._sequence))

    def status(self) -> SourceStatus:
        """Describe the source now."""
        return self.ingest.status(
            detail=self._detail, server="VRPN" if self.greeted else "", bodies=self.bodies
        )
