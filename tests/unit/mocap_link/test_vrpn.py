"""VRPN bytes against vectors written out by hand from the protocol's description."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.mocap_link import vrpn
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.source import ClockKind, Pose, SourceState
from steerd.mocap_link.vrpn_client import VrpnSource
from steerd.mocap_link.zenoh_pose import BusPoseSource, encode_pose
from steerd.sim_hw.mocap.network import CLOSE, STREAM
from steerd.sim_hw.mocap.servers import VrpnServer
from steerd.sim_hw.plant.faults import Fault
from tests.unit.mocap_link.test_sessions import FRAME as ROOM_FRAME
from tests.unit.mocap_link.test_sessions import Room

MS = 1_000_000
SECOND = 1000 * MS
T0 = 77 * SECOND
CONFIG = IngestConfig(FrameConfig(up="y", body_forward="-z", marker_rear_x=0.2))


def test_cookie_description_and_pose_by_hand() -> None:
    cookie = b"vrpn: ver. 07.38  0\0\0\0\0\0"
    assert (vrpn.COOKIE, vrpn.check_cookie(cookie)) == (cookie, "07.38")
    assert vrpn.check_cookie(b"vrpn: ver. 07.36  0\0\0\0\0\0") == "07.36"
    for bad in (b"vrpn: ver. 08.00  0\0\0\0\0\0", cookie[:23], b""):
        with pytest.raises(vrpn.VrpnError):
            vrpn.check_cookie(bad)
    data = vrpn.encode(vrpn.make_description(vrpn.SENDER_DESCRIPTION, 2, "car"))
    # Length without padding (24 + 8), sec, usec, the id that is described, type -1, the name.
    by_hand = "00000020 00000000 00000000 00000002 ffffffff 00000000 00000004 63617200"
    assert data == bytes.fromhex(by_hand)
    pose = (1.0, 2.0, -0.5), (0.0, 0.0, 0.0, 1.0)
    payload = vrpn.write_pose(1, pose)
    zero, one = "0000000000000000", "3ff0000000000000"
    place = f"{one} 4000000000000000 bfe0000000000000"
    assert payload == bytes.fromhex(f"0000000100000000 {place} {3 * zero} {one}")
    assert vrpn.read_pose(payload) == (1, pose)
    with pytest.raises(vrpn.VrpnError):
        vrpn.read_pose(payload[:-1])


I32 = st.integers(-(2**31), 2**31 - 1)


@settings(derandomize=True, deadline=None, database=None, max_examples=60)
@given(st.integers(-10, 10), st.binary(max_size=64), I32, I32)
def test_messages_survive(kind, payload, sec, usec):
    message = vrpn.Message(kind, 3, sec, usec, payload, 9)
    data = vrpn.encode(message)
    assert (len(data) % 8, vrpn.decode_stream(data)) == (0, ([message], len(data)))
    assert vrpn.decode_stream(data[:-1])[0] == []


def test_impossible_lengths_end_the_stream_and_short_descriptions_are_refused() -> None:
    for length in (0, 23, -1, 65_537):
        with pytest.raises(vrpn.VrpnError):
            vrpn.decode_stream(length.to_bytes(4, "big", signed=True) + bytes(20))
    for payload in (b"", b"\0\0\0", b"\0\0\0\x05abc", b"\xff\xff\xff\xffabc"):
        with pytest.raises(vrpn.VrpnError):
            vrpn.read_description(payload)


def make_pair(*bodies: str, t_ns: int = T0) -> tuple[VrpnSource, VrpnServer]:
    """Source and server that have greeted each other."""
    client, server = VrpnSource("car", CONFIG), VrpnServer(bodies or ("car", "b2"))
    assert server.receive(client.on_connect(), 0) == b""
    assert client.on_bytes(server.hello(), t_ns) == []
    return client, server


def test_session_greets_maps_ids_answers_pings_and_ends_with_goodbye() -> None:
    client, server = make_pair(t_ns=0)
    assert client.on_bytes(server.pose("b2", 5, (1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0)), 7) == []
    q = (0.9, 0.1, 0.2, 0.3)  # its order changes at the wire
    (raw,) = client.on_bytes(server.pose("car", 2_500_000, (1.0, 2.0, 3.0), q), 7)
    assert (raw.source_ticks, raw.position, raw.quaternion) == (2_500_000, (1.0, 2.0, 3.0), q)
    (pong,), _ = vrpn.decode_stream(server.receive(client.on_timer(10), 9))
    assert (pong.stamp_us, pong.payload) == (9, b"")
    client, server = make_pair()
    client.on_bytes(vrpn.encode(vrpn.Message(vrpn.DISCONNECT, 0)), 1)
    assert client.dead == "the server ended the session"
    assert client.on_bytes(server.pose("car", 1, (1.0,) * 3, (1.0, 0.0, 0.0, 0.0)), 2) == []
    assert client.on_timer(3) == b""


# VRPN and bus sources in virtual time: drive, freeze, reconnect, half-open, bad payloads.
class VrpnRoom(Room):
    """The room with a VRPN server, to which the source has to be connected."""

    def __init__(self, *faults: Fault) -> None:
        super().__init__(*faults, source=VrpnSource("car", IngestConfig(ROOM_FRAME)), kind="vrpn")

    def connect(self) -> None:
        self.world.mocap.on_connect(self.now, 0)
        self.world.mocap_write(self.now, self.source.on_connect(), STREAM)

    def step(self) -> None:
        if data := self.source.on_timer(self.now):
            self.world.mocap_write(self.now, data, STREAM)
        self.now += 5 * MS
        for message in self.world.mocap_read(self.now):
            if message.channel == CLOSE:
                self.source.on_disconnect("gone")
            else:
                self.take(self.source.on_bytes(message.data, message.t_ns))


def test_vrpn_drive_freeze_and_reconnect() -> None:
    room = VrpnRoom(Fault("M2", 4000 * MS, 4200 * MS), Fault("server_restart", 5 * SECOND))
    room.run(0.1)
    assert room.state is SourceState.CONNECTING
    room.connect()
    samples = room.run(3.9)
    assert room.source.status().bodies == ("car", "b2")
    assert room.state is SourceState.OK
    assert {s.clock for s in samples[210:]} == {ClockKind.HULL}
    room.assert_no_jump(samples)
    room.run(0.2)
    assert room.count("frozen") >= 15
    room.run(1.5)
    assert room.source.status().detail == "gone"
    assert room.state is SourceState.LOST
    room.connect()
    room.source.ingest.stationary = True
    room.assert_no_jump(room.run(2.5))
    assert room.state is SourceState.OK


@pytest.mark.parametrize("held", [2, 6, 12])
def test_poses_that_tcp_held_back_are_each_where_the_car_was(held: int) -> None:
    room = VrpnRoom()
    room.source.ingest.timing.extra_latency_ns = 5_480_000  # what the simulated cameras take
    room.connect()
    room.run(3.0)
    room.samples.clear()
    room.now += held * 10 * MS
    segment = b"".join(message.data for message in room.world.mocap_read(room.now))
    room.take(room.source.on_bytes(segment, room.now))
    room.run(0.2)
    assert len(room.samples) >= held + 19
    for sample in room.samples:
        assert (sample.rejected, sample.clock) == (None, ClockKind.HULL)
        assert room.error(sample) < 1e-3  # a millisecond of time at 1 m/s


def test_vrpn_body_that_is_enabled_later() -> None:
    source, server = make_pair("b2")
    assert "it offers: b2" in source.status().detail
    server.bodies += ("car",)
    source.on_bytes(vrpn.encode(vrpn.make_description(vrpn.SENDER_DESCRIPTION, 1, "car")), T0)
    pose = server.pose("car", 10**15, (1.0, 2.0, 0.1), (1.0, 0.0, 0.0, 0.0))
    assert len(source.on_bytes(pose, T0)) == 1


def test_bus_poses() -> None:
    source = BusPoseSource(IngestConfig())
    for t in range(0, 3000 * MS, 10 * MS):
        place, ahead = (1e-10 * t, 0.5, 0.1), (1.0, 0.0, 0.0, 0.0)
        raw = Pose("car", t // (10 * MS), t, None, 0, place, ahead, 1e-4)
        good = source.on_message(encode_pose(raw), T0 + t + 3 * MS)
        source.on_timer(T0 + t + 4 * MS)
    assert (good.rejected, good.clock) == (None, ClockKind.HULL)
    assert source.status().state is SourceState.OK
    other = b'{"v":2,"body":"c","seq":1,"p":[0,0,0],"q":[1,0,0,0]}'
    for bad in (b"", b"{}", b"\xff", other, b"[" * 4000):
        assert source.on_message(bad, T0) is None


@pytest.mark.parametrize("name", ["t_src_ns", "seq"])
@pytest.mark.parametrize("number", [-5, 10**400, 1 << 63], ids=["negative", "long", "too large"])
def test_a_bus_pose_with_a_number_that_no_message_holds_is_malformed(name, number) -> None:
    source, good = BusPoseSource(IngestConfig()), (1 << 63) - 1
    pose = {"t_src_ns": 1, "seq": 7, "v": 1, "body": "car", "p": [1, 2, 3], "q": [1, 0, 0, 0]}
    assert source.on_message(json.dumps(pose | {name: number}).encode(), T0) is None
    assert name in source.status().detail
    assert source.on_message(json.dumps(pose | {name: good}).encode(), T0) is not None
