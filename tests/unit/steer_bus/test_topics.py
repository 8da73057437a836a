"""Keys and the topic table."""

import pytest

from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.fields import String, message, schema_text, type_name
from steerd.steer_bus.messages import StateMessage
from steerd.steer_bus.topics import make_node_token, make_publisher_token, make_ros_key
from tests.local_bus import key_matches


def test_keys_and_session_topics_lead_back_to_their_topic():
    assert topics.make_key("car1", topics.STATE) == "steerd/car1/state"
    assert topics.make_key("car1", topics.DRIVE, "desk") == "steerd/car1/cmd/drive/desk"
    assert topics.find_topic("steerd/car1/cmd/drive/desk") is topics.DRIVE
    assert topics.make_session_topic("car1", topics.DRIVE) == "/steerd/car1/cmd/drive"
    assert topics.make_key("car1", topics.ALIVE) == "steerd/car1/alive"
    for topic in topics.TOPICS:
        assert topics.find_topic(topics.make_key("c", topic)) is topic
        assert topics.find_topic(topics.make_session_topic("c", topic)) is topic


@pytest.mark.parametrize("car", ["", "Car", "a/b", "*", "a*", "**", "a b", "ä", "a\n", "x" * 65])
def test_bad_car_names_are_refused(car):
    with pytest.raises(ValueError, match="car name"):
        topics.make_key(car, topics.STATE)


@pytest.mark.parametrize("key", ["steerd", "steerd/car1", "other/car1/state", "steerd/C/state", ""])
def test_foreign_keys_have_no_topic(key):
    assert topics.split_key(key) is None
    assert topics.find_topic(key) is None
    assert topics.find_topic("steerd/car1/nothing") is None


def test_commands_are_urgent_and_inward_and_every_topic_on_the_bus_has_its_schema_served():
    inward = [topic for topic in topics.TOPICS if topic.direction == "in"]
    assert inward
    assert all(topic.priority == "REAL_TIME" for topic in inward)
    assert topics.DRIVE in inward
    replies = topics.schema_replies("car1")
    assert replies["steerd/car1/schema/steerd_msgs/msg/State"] == schema_text(StateMessage).encode()
    for topic in topics.TOPICS:
        if topic.on_bus:
            key = f"steerd/car1/schema/{type_name(topic.message)}"
            assert key in replies
            assert key_matches("steerd/*/schema/**", key)


# rmw_zenoh's names: against its own documentation's examples, and rosbags for the hashes.
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@message("std_msgs/msg/String")
class RosString:
    data: String


def test_keys_and_tokens_are_those_of_rmw_zenohs_design_page():
    zid = "aac3178e146ba6f1fc6e6a4085e77f21"
    key = f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert make_ros_key(0, "/chatter", RosString) == key
    assert make_node_token(0, zid, "listener") == f"@ros2_lv/0/{zid}/0/0/NN/%/%/listener"
    token = make_publisher_token(2, zid, 10, "talker", "/chatter", RosString)
    said = f"%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}/::,10:,:,:,,"
    assert token == f"@ros2_lv/2/{zid}/0/10/MP/%/%/talker/{said}"


# The clock: absolute deadlines and UNIX time.
@pytest.mark.parametrize("ahead_ns", [-1_000_000, 0, 2_000_000])
def test_monotonic_clock_never_wakes_early(ahead_ns):
    clock = MonotonicClock()
    deadline = clock.now_ns() + ahead_ns
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline
