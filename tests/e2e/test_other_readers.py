"""A whole drive's session in the hands of programs that know nothing of ours."""

from math import isnan

import pytest
from rosbags.highlevel import AnyReader

from steerd.steer_bus.session_read import open_session

DRIVEN = {
    "tick": "steerd_msgs/msg/Tick",
    "mocap": "steerd_msgs/msg/MocapPose",
    "vesc": "steerd_msgs/msg/VescTelemetry",
    "actuation": "steerd_msgs/msg/Actuation",
    "state": "steerd_msgs/msg/State",
    "transition": "steerd_msgs/msg/Transition",
    "odom": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "vesc_state": "vesc_msgs/msg/VescStateStamped",
    "model": "steerd_msgs/msg/Model",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "rosout": "rcl_interfaces/msg/Log",
}
"""What every drive must hold; the standard types are those that ROS tools draw."""


@pytest.fixture
def driven(drive_fast):
    return drive_fast("--path circle:radius=2 --speed 1 --duration 2 --learn")


def same(theirs, ours):
    """Whether a foreign decoder's value is ours, field by field."""
    if hasattr(ours, "__dataclass_fields__"):
        return all(same(getattr(theirs, n), getattr(ours, n)) for n in ours.__dataclass_fields__)
    if isinstance(ours, float) and isnan(ours):
        return isnan(theirs)
    if isinstance(ours, bytes):
        return bytes(theirs) == ours
    if isinstance(ours, str | int | float):
        return theirs == ours
    return len(theirs) == len(ours) and all(map(same, theirs, ours))


def by_topic(session):
    """Our own reading: records of every topic, in order."""
    found = {}
    for record in open_session(session).messages():
        found.setdefault(record.topic, []).append(record)
    return found


def some(records):
    """First, middle and last."""
    return sorted({0, len(records) // 2, len(records) - 1})


def check_topics(kinds, counts, ours):
    for name, kind in DRIVEN.items():
        assert kinds[f"/steerd/car1/{name}"] == kind
    for topic, records in ours.items():
        assert counts[topic] == len(records), topic
    assert len(ours["/steerd/car1/tick"]) > 300
    assert set(DRIVEN) <= {topic.removeprefix("/steerd/car1/") for topic in ours}


def test_rosbags_reads_a_drive(driven):
    ours = by_topic(driven.session)
    with AnyReader([driven.session]) as reader:
        kinds = {topic: info.msgtype for topic, info in reader.topics.items()}
        check_topics(kinds, {t: info.msgcount for t, info in reader.topics.items()}, ours)
        for topic, records in ours.items():
            connections = [c for c in reader.connections if c.topic == topic]
            messages = list(reader.messages(connections))
            for i in some(records):
                connection, log_ns, data = messages[i]
                assert log_ns == records[i].log_ns
                theirs = reader.deserialize(data, connection.msgtype)
                assert same(theirs, records[i].decode()), (topic, i)
