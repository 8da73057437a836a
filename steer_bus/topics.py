"""What travels on the bus, and under which keys: one table of topics; ROS's names of them.

A key is ``steerd/<car>/<name>``; the same topic in a session file is ``/`` + key, so that tools see
a valid ROS name. Beside the topics a car serves ``param/**``, ``srv/*`` and ``schema/<type>`` and
holds the liveliness token ``alive``.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import xxhash  # noqa: TID251

from steerd.steer_bus import messages as m
from steerd.steer_bus import standard
from steerd.steer_bus.codec import MAX_BYTES
from steerd.steer_bus.fields import schema_text, type_hash, type_name

ROOT = "steerd"
_CAR_NAME = re.compile(r"[a-z0-9_]{1,64}")


class BusError(Exception):
    """The bus cannot do what was requested, in one line that says what to change."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message."""

    key: str  # the key it was published under
    data: bytes  # the encoded message
    seq: int = 0  # the publisher's counter for this key, from 1; 0 if the sender gives none
    sent_ns: int = 0  # the publisher's UNIX time [ns]; 0 if the sender gives none
    sender: bytes = b""  # the publisher's id of 16 bytes; empty if the sender gives none


Answer = Callable[[str], bytes | None]
"""Gives the value of a key, or None if there is none; may run in another thread."""
Keep = Callable[[bytes], bool]
"""Whether a message is worth its place in a ring; never raises, may run in another thread."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a car."""

    name: str  # the key below ``steerd/<car>/``
    message: type[Any]  # the message class
    direction: Literal["in", "out"] = "out"  # who publishes it: who commands the car, or the car
    priority: Literal["REAL_TIME", "DATA", "DATA_LOW"] = "DATA"  # on the network, as zenoh's names
    logged: bool = True  # whether the recorder writes it
    on_bus: bool = True  # whether the gateway carries it (raw inputs stay in the session file)
    rate_hz: float = 0.0  # nominal rate; 0 for events


TICK = Topic("tick", m.Tick, rate_hz=200.0)
MOCAP = Topic("mocap", m.MocapPose, rate_hz=200.0)
VESC = Topic("vesc", m.VescTelemetry, rate_hz=200.0)
IDENTITY = Topic("vesc_identity", m.VescIdentity)
IMU = Topic("imu", m.VescImu, rate_hz=200.0)
ACTUATION = Topic("actuation", m.Actuation, rate_hz=200.0)
STATE = Topic("state", m.StateMessage, priority="REAL_TIME", rate_hz=200.0)
TRANSITION = Topic("transition", m.Transition)
CLOCK = Topic("clock", m.ClockSample, rate_hz=1.0)
DRIVE = Topic("cmd/drive", m.DriveCommand, "in", "REAL_TIME", rate_hz=100.0)
OPERATOR = Topic("cmd/operator", m.OperatorRequest, "in", "REAL_TIME")
ODOM = Topic("odom", standard.Odometry, logged=False, rate_hz=50.0)
POSE = Topic("pose", standard.PoseStamped, logged=False, rate_hz=50.0)
EXTERNAL_POSE = Topic("in/pose", standard.PoseStamped, "in", "REAL_TIME", rate_hz=200.0)
VESC_STATE = Topic("vesc_state", standard.VescStateStamped, logged=False, rate_hz=50.0)
DIAGNOSTICS = Topic("diagnostics", standard.DiagnosticArray, priority="DATA_LOW", rate_hz=1.0)
LOG = Topic("rosout", standard.Log, priority="DATA_LOW")
WHEEL = Topic("wheel", m.WheelSpeed, on_bus=False, rate_hz=100.0)
THROTTLE = Topic("throttle", m.Throttle, on_bus=False, rate_hz=100.0)
SET_PARAMETERS = Topic("cmd/parameters", m.ParameterRequest, "in", "REAL_TIME")
PARAMETERS = Topic("parameters", m.Parameters, priority="DATA_LOW", rate_hz=2.0)
MODEL = Topic("model", m.Model, priority="DATA_LOW", rate_hz=1.0)
DESIGN = Topic("design", m.Design, priority="DATA_LOW", rate_hz=1.0)
STOP = Topic("cmd/stop", m.OperatorRequest, "in", "REAL_TIME", logged=False)
HEARTBEAT = Topic("heartbeat", m.Heartbeat, "out", "REAL_TIME", False, rate_hz=20.0)
HEARTBEAT_BACK = Topic("cmd/heartbeat", m.Heartbeat, "in", "REAL_TIME", False, rate_hz=20.0)

ALIVE = "alive"  # name of a car's liveliness token
LAST_MODEL = "param/model"  # key under which a car answers with its newest `model` message

TOPICS = tuple(topic for topic in [*vars().values()] if isinstance(topic, Topic))
"""In the order of the channels of a session file."""


def check_car_name(car: str) -> str:
    """Give a name back; ValueError unless it is 1 to 64 of ``a-z 0-9 _`` (zenoh takes ``*``)."""
    if not _CAR_NAME.fullmatch(car):
        raise ValueError(f"car name {car!r}: use 1 to 64 of a-z, 0-9 and _")
    return car


def make_key(car: str, topic: Topic | str, who: str = "") -> str:
    """The bus key of a car's topic, or of a name such as `ALIVE`; ValueError on a bad car name.

    It ends with the sender's name, `who`, where certificates prove that.
    """
    name = topic.name if isinstance(topic, Topic) else topic
    return "/".join((ROOT, check_car_name(car), name, *((who,) if who else ())))


def make_session_topic(car: str, topic: Topic) -> str:
    """Make the topic's name in a session file; raises as :func:`make_key`."""
    return f"/{make_key(car, topic)}"


def split_key(key: str) -> tuple[str, str] | None:
    """Give (car, name) of a bus key or a session topic, or None if it is not steerd's."""
    root, _, rest = key.removeprefix("/").partition("/")
    car, _, name = rest.partition("/")
    return (car, name) if root == ROOT and name and _CAR_NAME.fullmatch(car) else None


def find_topic(key: str) -> Topic | None:
    """Give the table's row for a bus key, with a sender's name or without, or a session topic."""
    parts = split_key(key)
    name = "/".join(parts[1].split("/")[:2]) if parts else ""
    return next((t for t in TOPICS if t.name == name), None)


def schema_replies(car: str) -> dict[str, bytes]:
    """Give every schema a car serves, by key, so that any recorder can be generic."""
    classes = {topic.message for topic in TOPICS if topic.on_bus}
    return {make_key(car, f"schema/{type_name(cls)}"): schema_text(cls).encode() for cls in classes}


def check_size(data: bytes) -> bytes:
    """Give a message back; BusError above ``MAX_BYTES``, which a receiver drops silently."""
    if len(data) > MAX_BYTES:
        raise BusError(f"a message of {len(data)} bytes exceeds {MAX_BYTES}")
    return data


def check_key(key: str) -> str:
    """Give a key back; BusError if it has an empty chunk, or holds one of ``* $ # ?``."""
    if not all(key.split("/")) or any(mark in key for mark in "*$#?"):
        raise BusError(f"{key!r} is no key to publish under")
    return key


# -- ROS -----------------------------------------------------------------------------------------

# Names under which rmw_zenoh finds a publisher: data keys, liveliness tokens, publisher ids.
# Source: `docs/reference/sessions-and-bus.md#b3`; rmw_zenoh's design page and its
# `liveliness_utils` (form since 0.2, binary attachment since 0.6). Data travel under
# ``<domain>/<topic>/<dds type>/<hash>``; a node and each of its publishers show themselves by a
# token under ``@ros2_lv/``, in which ``%`` stands for ``/``.
DOMAIN_MAX = 232
"""Largest ROS domain that DDS has ports for; rmw_zenoh takes more, other tools do not."""
_QOS = "::,10:,:,:,,"
"""Reliable, volatile, keep last 10, no deadline, no lifespan: rmw_zenoh leaves defaults empty."""
_SPACE = "@ros2_lv"
_NODE_ID = 0
_NONE = "%"


def _dds_type(cls: type[Any]) -> str:
    """A message's type as DDS writes it: ``nav_msgs::msg::dds_::Odometry_``."""
    package, kind, name = type_name(cls).split("/")
    return f"{package}::{kind}::dds_::{name}_"


def make_ros_key(domain: int, topic: str, cls: type[Any]) -> str:
    """The key under which a ROS subscription to `topic` receives messages of `cls`."""
    return f"{domain}/{topic.strip('/')}/{_dds_type(cls)}/{type_hash(cls)}"


def make_node_token(domain: int, zid: str, node: str) -> str:
    """The token of a node without namespace; `zid` is the zenoh session's id in hexadecimal."""
    ids = f"{domain}/{zid}/{_NODE_ID}/{_NODE_ID}"
    return f"{_SPACE}/{ids}/NN/{_NONE}/{_NONE}/{node}"


def make_publisher_token(
    domain: int, zid: str, entity: int, node: str, topic: str, cls: type[Any]
) -> str:
    """The token of a node's publisher; `entity` is its number within the session."""
    ids = f"{domain}/{zid}/{_NODE_ID}/{entity}"
    name = f"/{topic.strip('/')}".replace("/", _NONE)
    said = f"{name}/{_dds_type(cls)}/{type_hash(cls)}/{_QOS}"
    return f"{_SPACE}/{ids}/MP/{_NONE}/{_NONE}/{node}/{said}"


def make_gid(token: str) -> bytes:
    """The 16 bytes by which ROS knows a publisher: XXH3-128 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")
