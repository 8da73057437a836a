"""The bridge into ROS's graph, on a bus that records what is published."""

import struct

import pytest

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.process.ros_bridge import RosBridge
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.bus import BusError
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.ros_keys import make_gid, make_ros_key
from steerd.steer_bus.standard import AckermannDriveStamped
from tests.local_bus import LocalBus, LocalHub


class NamedBus(LocalBus):
    """A local bus that has an id and remembers its publishers' ids."""

    zid = "ab12"

    def __init__(self, hub):
        super().__init__(hub)
        self.gids = {}

    def name_publisher(self, key, gid):
        self.gids[key] = gid


@pytest.fixture
def bus():
    return NamedBus(LocalHub())


def test_each_publisher_has_a_token_whose_hash_it_sends(bus):
    RosBridge(bus, "car1", 5)
    tokens = bus.alive("@ros2_lv/5/ab12/**")
    publishers = {t for t in tokens if "/MP/" in t}
    assert len(tokens - publishers) == 1  # the node
    assert {make_gid(token) for token in publishers} == set(bus.gids.values())
    assert len(bus.gids) == len(publishers)
    assert not [key for key in bus.gids if "/cmd/" in key or "/in/" in key]


def test_a_record_goes_out_once_and_unchanged(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/**", 8)
    data = encode(m.ClockSample(m.make_header(1, m.BODY), 2, 3, 4))
    bridge.publish(PipeRecord(topics.CLOCK, 0, 0, 0, data))
    (sample,) = heard.poll()
    assert (sample.key, sample.data) == (
        make_ros_key(0, "steerd/car1/clock", m.ClockSample), data,
    )  # fmt: skip


def test_what_went_to_the_wire_goes_out_as_a_drive_command_too(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/steerd/car1/drive/**", 8)
    sent = m.Actuation(m.make_header(7, m.BODY), 1, m.ActuationMode.SPEED, 0.25, 1.5, 0.0, b"\2")
    bridge.publish(PipeRecord(topics.ACTUATION, 0, 0, 0, encode(sent)))
    (sample,) = heard.poll()
    drive = decode(AckermannDriveStamped, sample.data)
    assert (drive.header, drive.drive.steering_angle, drive.drive.speed) == (sent.header, 0.25, 1.5)
    assert sample.data[-20:] == struct.pack("<5f", 0.25, 0.0, 1.5, 0.0, 0.0)


def test_what_is_not_the_cars_to_send_stays(bus):
    bridge = RosBridge(bus, "car1", 0)
    heard = bus.subscribe("0/**", 8)
    bridge.publish(PipeRecord(topics.OPERATOR, 0, 0, 0, b""))
    assert heard.poll() == []


def test_a_closed_bus_stops_no_gateway(bus):
    bridge = RosBridge(bus, "car1", 0)
    bus.close()
    data = encode(m.ClockSample(m.make_header(1, m.BODY), 2, 3, 4))
    bridge.publish(PipeRecord(topics.CLOCK, 0, 0, 0, data))
    with pytest.raises(BusError):
        bus.publish("a", data)
