"""External pose topic, schema v1: anything that can publish JSON can be the mocap system.

One JSON object per pose::

    {"v": 1, "body": "car", "t_src_ns": 123 | null, "seq": 7,
     "p": [x, y, z], "q": [w, x, y, z], "valid": true, "err": 0.0005 | null}

`p` and `q` are in the publisher's units and axes, `t_src_ns` on the publisher's own clock. The
bus is not this module's business: bytes in, `Pose` out.
"""

from typing import Annotated

import msgspec

from steerd.mocap_link.ingest import IngestConfig, PoseIngest
from steerd.mocap_link.source import Pose, SourceStatus
from steerd.mocap_link.timing import DEFAULT_EXTRA_LATENCY_NS, SourceTiming

TICKS_HZ = 1_000_000_000
MAX_PAYLOAD = 4096

_Count = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
"""What a recorded pose can hold of a stamp and of a frame number."""


class PoseError(ValueError):
    """A payload that is not a pose of schema v1."""


class _Pose(msgspec.Struct, frozen=True):
    v: int
    body: str
    seq: _Count
    p: tuple[float, float, float]
    q: tuple[float, float, float, float]
    t_src_ns: _Count | None = None
    valid: bool = True
    err: float | None = None


_DECODER = msgspec.json.Decoder(_Pose)
_ENCODER = msgspec.json.Encoder()


def decode_pose(payload: bytes, t_arrival_ns: int) -> Pose:
    """Decode one payload.

    Raises:
        PoseError: not JSON, not schema v1, larger than 4 kB, or a stamp or sequence number
            outside 0 to 2^63 - 1.
    """
    if len(payload) > MAX_PAYLOAD:
        raise PoseError(f"pose of {len(payload)} bytes")
    try:
        pose = _DECODER.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise PoseError(str(error)) from error
    if pose.v != 1:
        raise PoseError(f"schema version {pose.v}, expected 1")
    return Pose(
        pose.body, pose.seq, pose.t_src_ns, None, t_arrival_ns, pose.p, pose.q, pose.err, pose.valid
    )


def encode_pose(raw: Pose) -> bytes:
    """Encode one payload; NaN and infinity become null and will not decode."""
    return _ENCODER.encode(
        _Pose(
            1,
            raw.body,
            raw.frame or 0,
            raw.position,
            raw.quaternion,
            raw.source_ticks,
            raw.tracking_valid,
            raw.mean_error,
        )
    )


class BusPoseSource:
    """The external pose topic, from payloads to samples; whoever owns the bus feeds it."""

    def __init__(self, config: IngestConfig, *, extra_latency_ns: int | None = None) -> None:
        extra = DEFAULT_EXTRA_LATENCY_NS["zenoh"] if extra_latency_ns is None else extra_latency_ns
        self.ingest = PoseIngest(config, SourceTiming(TICKS_HZ, extra))
        self.malformed = 0
        self._detail = "waiting for a first pose"
        self._body = ""

    def on_message(self, payload: bytes, t_arrival_ns: int) -> Pose | None:
        """Take in one payload; one that is not a pose is counted and gives None."""
        try:
            raw = decode_pose(payload, t_arrival_ns)
        except PoseError as error:
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
