"""Poses from the bus: schema v1, which anything that can publish JSON can send, and ROS 2.

One JSON object per pose::

    {"v": 1, "body": "car", "t_src_ns": 123 | null, "seq": 7,
     "p": [x, y, z], "q": [w, x, y, z], "valid": true, "err": 0.0005 | null}

`p` and `q` are in the publisher's units and axes, `t_src_ns` on the publisher's own clock. Of ROS
localisers: Odometry, PoseStamped and PoseWithCovarianceStamped in CDR, as rmw_zenoh sends. The
bus is not this module's business: bytes in, `Pose` out.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import msgspec

from steerd.mocap_link.clock_sync import DEFAULT_EXTRA_LATENCY_NS, SourceTiming
from steerd.mocap_link.ingest import IngestConfig, PoseIngest
from steerd.mocap_link.mocap_url import MocapUrl
from steerd.mocap_link.source import Pose, SourceStatus
from steerd.steer_bus import standard
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.fields import message

TICKS_HZ = 1_000_000_000
MAX_PAYLOAD = 4096

_Count = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
"""What a recorded pose can hold of a stamp and of a frame number."""


class PoseError(ValueError):
    """A payload that is not a pose."""


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
    sent = raw.frame or 0, raw.position, raw.quaternion, raw.source_ticks
    return _ENCODER.encode(_Pose(1, raw.body, *sent, raw.tracking_valid, raw.mean_error))


@message("geometry_msgs/msg/PoseWithCovarianceStamped")
class PoseWithCovarianceStamped:
    """A pose with its covariance in a frame at a time."""

    header: standard.Header
    pose: standard.PoseWithCovariance


_ROS_POSES = (standard.PoseStamped, PoseWithCovarianceStamped, standard.Odometry)


def decode_ros_pose(payload: bytes, t_arrival_ns: int) -> Pose:
    """Decode one ROS message [m]; its type is the one whose layout the bytes fill to the end.

    A stamp that is not after 1970 is none.

    Raises:
        PoseError: it is none of the three.
    """
    for kind in _ROS_POSES:
        try:
            sent: Any = decode(kind, payload)
        except CodecError:
            continue
        pose = sent.pose if kind is standard.PoseStamped else sent.pose.pose
        p, q = pose.position, pose.orientation
        ticks, frame = standard.stamp_ns(sent.header), sent.header.frame_id
        return Pose(
            frame, None, ticks if ticks > 0 else None, None, t_arrival_ns,
            (p.x, p.y, p.z), (q.w, q.x, q.y, q.z),
        )  # fmt: skip
    what = "not an Odometry, a PoseStamped or a PoseWithCovarianceStamped"
    raise PoseError(f"{len(payload)} bytes that are {what}: is it the right topic?")


def make_bus_source(url: MocapUrl, config: IngestConfig) -> "BusPoseSource":
    """The source of an address with a key.

    Raises:
        ValueError: the up axis contradicts the body's forward axis.
    """
    config = replace(config, frame=url.apply(config.frame))
    return BusPoseSource(config, decode_ros_pose if url.scheme == "ros2" else decode_pose)


class BusPoseSource:
    """The external pose topic, from payloads to samples; whoever owns the bus feeds it."""

    def __init__(
        self, config: IngestConfig, decode_bytes: Callable[[bytes, int], Pose] = decode_pose
    ) -> None:
        self._decode = decode_bytes
        self.ingest = PoseIngest(config, SourceTiming(TICKS_HZ, DEFAULT_EXTRA_LATENCY_NS["zenoh"]))
        self._detail = "waiting for a first pose"
        self._body = ""

    def on_message(self, payload: bytes, t_arrival_ns: int) -> Pose | None:
        """Take in one payload; one that is not a pose gives None."""
        try:
            raw = self._decode(payload, t_arrival_ns)
            if self._body not in ("", raw.body):
                raise PoseError(f"a pose of {raw.body!r}, those before were of {self._body!r}")
        except PoseError as error:
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
        return self.ingest.status(detail=self._detail, bodies=(self._body,) if self._body else ())
