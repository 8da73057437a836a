"""A NatNet source without I/O: datagrams and time in, poses and datagrams out.

Connects with backoff, follows the model list, measures the server's clock (20 echoes 5 ms apart,
then 2 Hz), keeps a unicast session alive, and starts over when frames stop. `sockets` feeds it from
the network; the simulator's virtual time feeds it the same datagrams directly.
"""

from typing import Literal

from steerd.mocap_link import natnet
from steerd.mocap_link.clock_sync import DEFAULT_EXTRA_LATENCY_NS, SourceTiming
from steerd.mocap_link.ingest import IngestConfig, PoseIngest
from steerd.mocap_link.natnet_wire import (
    BITSTREAM_CHANGED,
    EDIT_MODE,
    MODEL_CHANGED,
    Frame,
    NatNetError,
    RigidBody,
)
from steerd.mocap_link.source import Pose, SourceStatus

MS = 1_000_000
SECOND = 1000 * MS
_LEGACY_TICKS_HZ = 1_000_000
"""Seconds since start are taken as microseconds where there are no ticks."""

Socket = Literal["command", "data"]

UNANSWERED = (
    "no answer for 3 s: is the host right and on this network, does it stream NatNet "
    "(Motive: Settings > Streaming), does a firewall stop UDP port 1510?"
)
"""What to check when a server has never answered."""


class NatNetSource:
    """A NatNet server's one body, from datagrams to poses.

    Args:
        body: name of the rigid body, or `id:42`.
        server_ip: the only address that is listened to.
        config: how its poses are timed, placed and judged.
        unicast: force unicast (True) or multicast (False); None follows the server.

    Attributes:
        ingest: the pipeline of its poses.
        info: the server, once it answered.
        refused: why the configured body cannot be used, or None.
    """

    retry_first_ns = SECOND // 2
    retry_last_ns = 5 * SECOND
    silence_ns = SECOND
    unanswered_ns = 3 * SECOND
    burst_echoes = 20
    burst_period_ns = 5 * MS
    echo_period_ns = SECOND // 2
    keepalive_period_ns = SECOND
    model_period_ns = SECOND // 4
    malformed_to_reconnect = 10

    def __init__(
        self, body: str, server_ip: str, config: IngestConfig, *, unicast: bool | None = None
    ) -> None:
        self.body = body
        self.server_ip = server_ip
        self.ingest = PoseIngest(config, SourceTiming(1))
        self._echo_resets = 0
        self._foreign, self._foreign_ip = 0, ""
        self._framed = False
        self.info: natnet.ServerInfo | None = None
        self._note = "waiting for the server to answer"
        self._silence = ""
        self.refused: str | None = None
        self.bodies: tuple[str, ...] = ()
        self._by_name = not body.startswith("id:")
        self._id = None if self._by_name else int(body[3:])
        self._known_ids: frozenset[int] = frozenset()
        self._unicast = unicast
        self._connecting = True
        self._retry_ns = self.retry_first_ns
        self._connect_due = self._echo_due = self._keepalive_due = self._model_due = 0
        self._model_wanted = False
        self._rate_wanted = False
        self._burst_left = 0
        self._echoes: dict[int, None] = {}
        self._frame_seen_ns: int | None = None
        self._called_ns: int | None = None
        self._malformed_run = 0

    @property
    def detail(self) -> str:
        """The latest event to report."""
        return self.refused or self._silence or self._note

    @property
    def connected(self) -> bool:
        """Whether the server answered and frames have not stopped since."""
        return self.info is not None and not self._connecting

    @property
    def unicast(self) -> bool:
        """Whether frames come to us alone."""
        if self._unicast is not None:
            return self._unicast
        return self.info is not None and not self.info.multicast

    def on_datagram(
        self, data: bytes, t_arrival_ns: int, from_ip: str, which: Socket = "command"
    ) -> list[Pose]:
        """Take in one datagram; never raises.

        Args:
            data: the datagram.
            t_arrival_ns: time of reception, CLOCK_MONOTONIC.
            from_ip: who sent it; from another address than the server's it is dropped.
            which: the socket that it came to; sessions are spoken on the command socket only.
        """
        if from_ip != self.server_ip:
            self._foreign += 1
            self._foreign_ip = from_ip
            return []
        if self.info is None and natnet.peek_id(data) == natnet.FRAME_ID:
            return []  # of what version, we cannot know yet
        version = natnet.NEWEST_VERSION if self.info is None else self.info.version
        try:
            message = natnet.decode(data, version)
        except NatNetError as error:
            self._on_malformed(str(error), t_arrival_ns)
            return []
        self._malformed_run = 0
        if isinstance(message, Frame):
            return self._on_frame(message, t_arrival_ns)
        if which == "command":
            self._on_command(message, t_arrival_ns)
        return []

    def _on_command(self, message: natnet.Message, t_ns: int) -> None:
        match message:
            case natnet.ServerInfo():
                self._on_server_info(message, t_ns)
            case natnet.EchoResponse(client_stamp=t_sent_ns) if t_sent_ns in self._echoes:
                del self._echoes[t_sent_ns]
                self.ingest.timing.echo.add(t_sent_ns, t_ns, message.server_ticks)
            case natnet.ModelDef():
                self._on_model(message)
            case natnet.Response() if message.number is not None and self._rate_wanted:
                self._rate_wanted = False
                self.ingest.expect_rate(message.number)
            case natnet.Bare.DISCONNECT | natnet.Bare.DISCONNECT_BY_TIMEOUT:
                self._reconnect("the server ended the session")
            case natnet.MessageString():
                self._note = f"server: {message.text[:200]}"

    def _on_malformed(self, why: str, t_ns: int) -> None:
        self._malformed_run += 1
        if self._malformed_run == self.malformed_to_reconnect:
            # the stream may have changed its version: ask the server who it is
            self._malformed_run = 0
            self._connect_due = min(self._connect_due, t_ns + SECOND)
            self._reconnect(f"frames do not decode: {why}")

    def _on_server_info(self, info: natnet.ServerInfo, t_ns: int) -> None:
        if not natnet.OLDEST_VERSION <= info.version < (5, 0):
            spoken = f"{info.version[0]}.{info.version[1]}"
            self.refused = f"{info.name} speaks NatNet {spoken}; steerd reads 2.9 to 4.x"
            return
        if self.info == info and not self._connecting:
            return
        if self.info is not None:
            self.ingest.restart()
        self.info, self.refused = info, None
        self._connecting = False
        self._retry_ns = self.retry_first_ns
        self._frame_seen_ns = t_ns
        self._known_ids = frozenset()
        self._model_wanted = self._rate_wanted = True
        self._model_due = self._keepalive_due = 0
        self._echoes.clear()
        self._note = f"connected to {info.name}"
        extra = DEFAULT_EXTRA_LATENCY_NS["natnet" if info.clock_hz else "natnet2"]
        hz = info.clock_hz or _LEGACY_TICKS_HZ
        self.ingest.timing = SourceTiming(hz, extra)
        self._echo_resets = 0
        self._request_sync()

    def _request_sync(self) -> None:
        """Measure the clock anew with a burst of echoes."""
        self._burst_left = self.burst_echoes
        self._echo_due = 0

    def _on_model(self, model: natnet.ModelDef) -> None:
        bodies = model.rigid_bodies
        self._model_wanted = False
        self.bodies = tuple(b.name for b in bodies)
        self._known_ids = frozenset(b.id for b in bodies)
        if self._by_name:
            ids = [b.id for b in bodies if b.name == self.body]
            self._id = ids[0] if ids else None
        else:
            ids = [b.id for b in bodies if b.id == self._id][:1]
        same_id = [b.name for b in bodies if b.id == self._id]
        self.refused = None
        if not ids:
            offered = ", ".join(self.bodies) or "none"
            self._note = f"no body {self.body!r} on the server; it offers: {offered}"
        elif len(ids) > 1:
            self.refused = f"{len(ids)} bodies are named {self.body!r}: rename one in the server"
        elif len(same_id) > 1:
            names = ", ".join(same_id)
            self.refused = f"bodies {names} share streaming id {self._id}: give each its own"
        else:
            self._note = f"following {self.body!r} (id {self._id})"

    def _on_frame(self, frame: Frame, t_ns: int) -> list[Pose]:
        self._frame_seen_ns, bodies = t_ns, frame.rigid_bodies
        self._silence, self._framed = "", True
        if frame.params & MODEL_CHANGED or any(b.id not in self._known_ids for b in bodies):
            self._model_wanted = True
        if frame.params & BITSTREAM_CHANGED:
            self._reconnect("the server changed its stream version")
        mine = [b for b in bodies if b.id == self._id]
        if len(mine) > 1:
            self.refused = f"{len(mine)} bodies stream with id {self._id}"
        if self.refused is not None or len(mine) != 1:
            self.ingest.note_absent(t_ns)
            return []
        return [self.ingest.push(self._make_pose(frame, mine[0], t_ns))]

    def _make_pose(self, frame: Frame, body: RigidBody, t_ns: int) -> Pose:
        x, y, z, w = body.quaternion
        transmit: int | None = frame.transmit_ticks or None
        source: int | None = frame.mid_exposure_ticks or transmit
        if self.info is not None and not self.info.clock_hz:
            # before 3.0 there are no ticks: seconds since start, taken as microseconds
            micros = frame.timestamp * 1e6
            source = round(micros) if 0.0 < micros < 2**63 else None
        sent = self.body, frame.number, source, transmit, t_ns, body.position, (w, x, y, z)
        return Pose(*sent, body.mean_error, body.tracking_valid, not frame.params & EDIT_MODE)

    def _reconnect(self, why: str) -> None:
        self._connecting = True
        self._note = why

    def on_timer(self, t_ns: int) -> list[bytes]:
        """Return the datagrams to send to the server's command port now.

        `t_ns` also stamps the echo, so pass the time of sending.
        """
        resets = self.ingest.timing.echo.resets
        if resets != self._echo_resets:
            self._echo_resets = resets
            self._request_sync()
        self.ingest.on_timer(t_ns, connected=self.connected)
        out: list[bytes] = []
        seen = self._frame_seen_ns
        if self.connected and seen is not None and t_ns - seen > self.silence_ns:
            self._silence = self._explain_silence()
            self._reconnect(self._silence)
        if self._connecting and t_ns >= self._connect_due:
            self._called_ns = t_ns if self._called_ns is None else self._called_ns
            out.append(natnet.encode(natnet.Bare.CONNECT))
            self._connect_due = t_ns + self._retry_ns
            self._retry_ns = min(2 * self._retry_ns, self.retry_last_ns)
        if self.info is not None:
            self._maintain(self.info, t_ns, out)
        elif self._called_ns is not None and t_ns - self._called_ns >= self.unanswered_ns:
            self._note = UNANSWERED
        return out

    def _maintain(self, info: natnet.ServerInfo, t_ns: int, out: list[bytes]) -> None:
        if self._model_wanted and t_ns >= self._model_due:
            out.append(natnet.encode(natnet.Bare.REQUEST_MODEL))
            self._model_due = t_ns + self.model_period_ns
            if self._rate_wanted:
                out.append(natnet.encode(natnet.Request("FrameRate")))
        if self.unicast and t_ns >= self._keepalive_due:
            out.append(natnet.encode(natnet.Bare.KEEP_ALIVE))
            self._keepalive_due = t_ns + self.keepalive_period_ns
        if info.clock_hz and t_ns >= self._echo_due:
            out.append(natnet.encode(natnet.EchoRequest(t_ns)))
            self._echoes[t_ns] = None
            while len(self._echoes) > 2 * self.burst_echoes:
                del self._echoes[next(iter(self._echoes))]
            burst = self._burst_left > 0
            self._burst_left = max(0, self._burst_left - 1)
            self._echo_due = t_ns + (self.burst_period_ns if burst else self.echo_period_ns)

    def _explain_silence(self) -> str:
        if self._framed:
            return "frames stopped; connecting anew"
        if self.unicast:
            return "the server answers but sends no frame: a firewall between, or streaming is off"
        return (
            "the server answers but no frame comes: multicast joined on the wrong interface "
            "(set interface=), a firewall, or streaming is off"
        )

    def status(self) -> SourceStatus:
        """Describe the source now."""
        info = self.info
        server = "" if info is None else f"{info.name} NatNet {info.version[0]}.{info.version[1]}"
        detail = self.detail
        if self._foreign and not self._framed:
            detail += f" ({self._foreign} datagrams came from {self._foreign_ip} instead)"
        return self.ingest.status(
            detail=detail, server=server, bodies=self.bodies, refused=self.refused is not None
        )
