"""Whole sources without I/O: a session and its pipeline, for sockets or for virtual time.

`sockets` feeds them from the network; the simulator's virtual time feeds them the same datagrams
directly.
"""

from collections import Counter

from steerd.mocap_link import vrpn_client, zenoh_pose
from steerd.mocap_link.ingest import IngestConfig, PoseIngest
from steerd.mocap_link.natnet import ServerInfo
from steerd.mocap_link.natnet_client import (
    BodyAbsent,
    Connected,
    EchoMeasured,
    Event,
    NatNetClient,
    RateKnown,
    Socket,
)
from steerd.mocap_link.source import Pose, SourceStatus
from steerd.mocap_link.timing import DEFAULT_EXTRA_LATENCY_NS, SourceTiming

_LEGACY_TICKS_HZ = 1_000_000


class NatNetSource:
    """A NatNet server's one body, from datagrams to samples.

    Args:
        body: name, or `id:42`.
        server_ip: the only address that is listened to.
        config: the pipeline.
        unicast: force it (True), force multicast (False), or follow the server (None).
        extra_latency_ns: None takes the protocol's default.
    """

    def __init__(
        self,
        body: str,
        server_ip: str,
        config: IngestConfig,
        *,
        unicast: bool | None = None,
        extra_latency_ns: int | None = None,
    ) -> None:
        self.client = NatNetClient(body, unicast=unicast)
        self.ingest = PoseIngest(config, SourceTiming(1, two_way=False))
        self.server_ip = server_ip
        self.foreign = 0
        self._foreign_ip = ""
        self._extra_latency_ns = extra_latency_ns
        self._info: ServerInfo | None = None
        self._echo_resets = 0

    def on_datagram(
        self, data: bytes, t_arrival_ns: int, from_ip: str, which: Socket = "command"
    ) -> list[Pose]:
        """Take in one datagram; one from another address is counted and dropped."""
        if from_ip != self.server_ip:
            self.foreign += 1
            self._foreign_ip = from_ip
            return []
        samples = []
        for event in self.client.on_datagram(data, t_arrival_ns, which):
            sample = self._on_event(event)
            if sample is not None:
                samples.append(sample)
        return samples

    def _on_event(self, event: Event) -> Pose | None:
        match event:
            case Connected():
                self._on_connected(event.info)
            case EchoMeasured():
                timing = self.ingest.timing
                timing.add_echo(event.t_sent_ns, event.t_received_ns, event.server_ticks)
            case RateKnown():
                self.ingest.expect_rate(event.rate_hz)
            case BodyAbsent():
                self.ingest.note_absent(event.t_arrival_ns)
            case _:
                return self.ingest.push(event)
        return None

    def _on_connected(self, info: ServerInfo) -> None:
        if self._info is not None:
            self.ingest.restart()
        self._info = info
        extra = self._extra_latency_ns
        if extra is None:
            extra = DEFAULT_EXTRA_LATENCY_NS["natnet" if info.clock_hz else "natnet2"]
        hz = info.clock_hz or _LEGACY_TICKS_HZ
        self.ingest.timing = SourceTiming(hz, extra, two_way=bool(info.clock_hz))
        self._echo_resets = 0

    def on_timer(self, t_ns: int) -> list[bytes]:
        """Let time pass; returns the datagrams for the server's command port."""
        resets = self.ingest.timing.echo_resets
        if resets != self._echo_resets:
            self._echo_resets = resets
            self.client.request_sync()
        self.ingest.on_timer(t_ns, connected=self.client.connected)
        return self.client.on_timer(t_ns)

    def status(self) -> SourceStatus:
        """Describe the source now."""
        client, info = self.client, self._info
        server = "" if info is None else f"{info.name} NatNet {info.version[0]}.{info.version[1]}"
        detail = client.detail
        if self.foreign and not client.counts["frames"]:
            detail += f" ({self.foreign} datagrams came from {self._foreign_ip} instead)"
        return self.ingest.status(
            connected=client.connected,
            detail=detail,
            server=server,
            bodies=client.bodies,
            refused=client.refused is not None,
            more_counts={**client.counts, "foreign": self.foreign},
        )


class VrpnSource:
    """A VRPN server's one body, from a byte stream to samples; survives reconnects."""

    def __init__(
        self, body: str, config: IngestConfig, *, extra_latency_ns: int | None = None
    ) -> None:
        extra = DEFAULT_EXTRA_LATENCY_NS["vrpn"] if extra_latency_ns is None else extra_latency_ns
        self.client = vrpn_client.VrpnClient(body)
        self.ingest = PoseIngest(config, SourceTiming(vrpn_client.TICKS_HZ, extra))
        self.up = False
        self._old_counts: Counter[str] = Counter()
        self._why = "connecting"

    @property
    def dead(self) -> str | None:
        """Why the connection must be closed, or None."""
        return self.client.dead

    def on_connect(self) -> bytes:
        """A TCP connection stands: begin a session; returns what to send."""
        self._old_counts += self.client.counts
        self.client = vrpn_client.VrpnClient(self.client.body)
        self.ingest.restart()
        self.up = True
        return self.client.hello()

    def on_disconnect(self, why: str) -> None:
        """The TCP connection ended."""
        self.up = False
        self._why = why

    def on_bytes(self, data: bytes, t_arrival_ns: int) -> list[Pose]:
        """Take in a piece of the stream."""
        return [self.ingest.push(raw) for raw in self.client.on_bytes(data, t_arrival_ns)]

    def on_timer(self, t_ns: int) -> bytes:
        """Let time pass; returns bytes to send."""
        self.ingest.on_timer(t_ns, connected=self.up and self.client.greeted)
        return self.client.on_timer(t_ns) if self.up else b""

    def status(self) -> SourceStatus:
        """Describe the source now."""
        return self.ingest.status(
            connected=self.up and self.client.greeted,
            detail=self.client.detail if self.up else self._why,
            server="VRPN" if self.client.greeted else "",
            bodies=self.client.bodies,
            more_counts=self._old_counts + self.client.counts,
        )


class BusPoseSource:
    """The external pose topic, from payloads to samples; whoever owns the bus feeds it."""

    def __init__(self, config: IngestConfig, *, extra_latency_ns: int | None = None) -> None:
        extra = DEFAULT_EXTRA_LATENCY_NS["zenoh"] if extra_latency_ns is None else extra_latency_ns
        self.ingest = PoseIngest(config, SourceTiming(zenoh_pose.TICKS_HZ, extra))
        self.malformed = 0
        self._detail = "waiting for a first pose"
        self._body = ""

    def on_message(self, payload: bytes, t_arrival_ns: int) -> Pose | None:
        """Take in one payload; one that is not a pose is counted and gives None."""
        try:
            raw = zenoh_pose.decode_pose(payload, t_arrival_ns)
        except zenoh_pose.PoseError as error:
            self.malformed += 1
            self._detail = str(error)
            return None
        self._body = raw.body
        self._detail = f"following {raw.body!r}"
        return self.ingest.push(raw)

    def on_timer(self, t_ns: int) -> None:
        """Let time pass."""
        self.ingest.on_timer(t_ns, connected=bool(self._body))

    def status(self) -> SourceStatus:
        """Describe the source now."""
        return self.ingest.status(
            connected=bool(self._body),
            detail=self._detail,
            bodies=(self._body,) if self._body else (),
            more_counts={"malformed": self.malformed},
        )
