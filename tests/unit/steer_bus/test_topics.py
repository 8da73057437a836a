"""Keys and the topic table."""

import re

import pytest

from steerd.steer_bus.codec import schema_text, type_name
from steerd.steer_bus.messages import StateMessage
from steerd.steer_bus.topics import (
    ALIVE,
    DRIVE,
    STATE,
    TOPICS,
    Direction,
    Priority,
    check_car_name,
    find_topic,
    make_key,
    make_session_topic,
    schema_replies,
    split_key,
)
from tests.local_bus import key_matches


def test_names_are_unique_and_valid_ros_names():
    names = [topic.name for topic in TOPICS]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*", name) for name in names)


def test_keys():
    assert make_key("car1", STATE) == "steerd/car1/state"
    assert make_key("car1", DRIVE, "desk") == "steerd/car1/cmd/drive/desk"
    assert find_topic("steerd/car1/cmd/drive/desk") is DRIVE
    assert make_session_topic("car1", DRIVE) == "/steerd/car1/cmd/drive"
    assert make_key("car1", ALIVE) == "steerd/car1/alive"


@pytest.mark.parametrize("car", ["", "Car", "a/b", "*", "a*", "**", "a b", "ä", "a\n", "x" * 65])
def test_bad_car_names_are_refused(car):
    with pytest.raises(ValueError, match="car name"):
        check_car_name(car)
    with pytest.raises(ValueError, match="car name"):
        make_key(car, STATE)


def test_a_topic_is_found_by_key_and_by_session_topic():
    for topic in TOPICS:
        assert find_topic(make_key("c", topic)) is topic
        assert find_topic(make_session_topic("c", topic)) is topic


@pytest.mark.parametrize("key", ["steerd", "steerd/car1", "other/car1/state", "steerd/C/state", ""])
def test_foreign_keys_have_no_topic(key):
    assert split_key(key) is None
    assert find_topic(key) is None
    assert find_topic("steerd/car1/nothing") is None


def test_commands_are_urgent_and_inward():
    inward = [topic for topic in TOPICS if topic.direction is Direction.IN]
    assert inward
    assert all(topic.priority is Priority.REAL_TIME for topic in inward)
    assert DRIVE in inward


def test_every_topic_on_the_bus_has_its_schema_served():
    replies = schema_replies("car1")
    assert replies["steerd/car1/schema/steerd_msgs/msg/State"] == schema_text(StateMessage).encode()
    for topic in TOPICS:
        if topic.on_bus:
            key = f"steerd/car1/schema/{type_name(topic.message)}"
            assert key in replies
            assert key_matches("steerd/*/schema/**", key)
