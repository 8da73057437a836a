"""rmw_zenoh's names: against its own documentation's examples, and rosbags for the hashes."""

import pytest

from steerd.steer_bus.fields import String, message
from steerd.steer_bus.ros_keys import (
    QOS,
    dds_type,
    make_gid,
    make_node_token,
    make_publisher_token,
    make_ros_key,
)
from steerd.steer_bus.standard import Odometry, PoseStamped
from steerd.steer_bus.topics import TOPICS

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@message("std_msgs/msg/String")
class RosString:
    data: String


def test_keys_and_tokens_are_those_of_rmw_zenohs_design_page():
    zid = "aac3178e146ba6f1fc6e6a4085e77f21"
    assert make_ros_key(0, "/chatter", RosString) == (
        f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    )
    assert make_node_token(0, zid, "listener") == f"@ros2_lv/0/{zid}/0/0/NN/%/%/listener"
    token = make_publisher_token(2, zid, 10, "talker", "/chatter", RosString)
    said = f"%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}/::,10:,:,:,,"
    assert token == f"@ros2_lv/2/{zid}/0/10/MP/%/%/talker/{said}"


def test_known_hashes_of_standard_messages():
    """As `ros2 topic info -v` shows them."""
    assert make_ros_key(7, "odom", Odometry).endswith(
        "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    )
    assert "RIHS01_10f3786d7d40fd2b54367835614bff85" in make_ros_key(7, "p", PoseStamped)


def test_a_publishers_id_is_xxh3_of_its_token_low_half_first():
    # The empty string's XXH3-128 is 99aa06d3014798d8 6001c324468d497f (xxHash's own test vector).
    assert make_gid("") == bytes.fromhex("99aa06d3014798d86001c324468d497f")[::-1]
    gids = {make_gid(f"token {n}") for n in range(100)}
    assert len(gids) == 100
    assert {len(gid) for gid in gids} == {16}


def test_a_token_is_split_into_the_fields_that_rmw_zenoh_counts():
    for topic in TOPICS:
        token = make_publisher_token(0, "ab", 11, "steerd_car1", topic.name, topic.message)
        fields = token.split("/")
        assert len(fields) == 13
        assert all(fields)
        assert fields[-2].startswith("RIHS01_")
        assert fields[-1] == QOS
        assert fields[9].replace("%", "/") == f"/{topic.name}"
        assert fields[10] == dds_type(topic.message)


@pytest.mark.parametrize("domain", [-1, 233])
def test_a_domain_that_is_none(domain):
    with pytest.raises(ValueError, match="0 to 232"):
        make_ros_key(domain, "odom", Odometry)
