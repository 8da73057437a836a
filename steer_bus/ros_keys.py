"""Names under which rmw_zenoh finds a publisher: data keys, liveliness tokens, publisher ids.

Source: `docs/reference/sessions-and-bus.md#b3`; rmw_zenoh's design page and its `liveliness_utils`
(form since 0.2, binary attachment since 0.6). Data travel under ``<domain>/<topic>/<dds
type>/<hash>``; a node and each of its publishers show themselves by a token under ``@ros2_lv/``, in
which ``%`` stands for ``/``.
"""

from typing import Any

import xxhash  # noqa: TID251

from steerd.steer_bus.codec import type_hash, type_name

DOMAIN_MAX = 232
"""Largest ROS domain that DDS has ports for; rmw_zenoh takes more, other tools do not."""
QOS = "::,10:,:,:,,"
"""Reliable, volatile, keep last 10, no deadline, no lifespan: rmw_zenoh leaves defaults empty."""
_SPACE = "@ros2_lv"
_NODE_ID = 0
_NONE = "%"


def check_domain(domain: int) -> int:
    """Give a ROS domain back if it is one.

    Raises:
        ValueError: unless it is 0 to 232.
    """
    if not 0 <= domain <= DOMAIN_MAX:
        raise ValueError(f"ROS domain {domain}: 0 to {DOMAIN_MAX}")
    return domain


def dds_type(cls: type[Any]) -> str:
    """A message's type as DDS writes it: ``nav_msgs::msg::dds_::Odometry_``."""
    package, kind, name = type_name(cls).split("/")
    return f"{package}::{kind}::dds_::{name}_"


def make_ros_key(domain: int, topic: str, cls: type[Any]) -> str:
    """The key under which a ROS subscription to `topic` receives messages of `cls`.

    Raises:
        ValueError: on a bad domain.
    """
    name = topic.strip("/")
    return f"{check_domain(domain)}/{name}/{dds_type(cls)}/{type_hash(cls)}"


def make_node_token(domain: int, zid: str, node: str) -> str:
    """The token of a node without namespace.

    Args:
        domain: ROS domain.
        zid: the zenoh session's id in hexadecimal digits.
        node: its name.

    Raises:
        ValueError: on a bad domain.
    """
    ids = f"{check_domain(domain)}/{zid}/{_NODE_ID}/{_NODE_ID}"
    return f"{_SPACE}/{ids}/NN/{_NONE}/{_NONE}/{node}"


def make_publisher_token(
    domain: int, zid: str, entity: int, node: str, topic: str, cls: type[Any]
) -> str:
    """The token of a node's publisher; `entity` is its number within the session.

    Raises:
        ValueError: on a bad domain.
    """
    ids = f"{check_domain(domain)}/{zid}/{_NODE_ID}/{entity}"
    name = f"/{topic.strip('/')}".replace("/", _NONE)
    said = f"{name}/{dds_type(cls)}/{type_hash(cls)}/{QOS}"
    return f"{_SPACE}/{ids}/MP/{_NONE}/{_NONE}/{node}/{said}"


def make_gid(token: str) -> bytes:
    """The 16 bytes by which ROS knows a publisher: XXH3-128 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")
