"""Corners of the NatNet session that a room's ordinary faults do not reach."""

from typing import Any

import pytest

from steerd.mocap_link import natnet
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import UNANSWERED, NatNetSource
from steerd.mocap_link.natnet_frame import BITSTREAM_CHANGED, Frame, RigidBody

MS = 1_000_000
SECOND = 1000 * MS
IP = "10.0.0.1"


def make_connected(make_server: Any, **fields: Any) -> tuple[NatNetSource, Any]:
    server, client = make_server(**fields), NatNetSource("car", IP, IngestConfig())
    for reply in server.answer(client.on_timer(0)[0], 0):
        client.on_datagram(reply, 1, IP)
        assert client.info == server.info()
    for datagram in client.on_timer(2):
        for reply in server.answer(datagram, 2):
            client.on_datagram(reply, 3, IP)
    assert client.connected
    assert client.detail == "following 'car' (id 1)"
    return client, server


def make_frame(server: Any, **fields: Any) -> bytes:
    body = RigidBody(1, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 0.9))
    return natnet.encode(Frame(9, (body,), **fields), server.version)


def test_a_host_that_never_answers_is_reported_after_three_seconds_with_what_to_check():
    client = NatNetSource("car", IP, IngestConfig())
    for t_ns in range(5 * SECOND, 8 * SECOND, 100 * MS):
        client.on_timer(t_ns)
        assert client.detail == "waiting for the server to answer"
    client.on_timer(8 * SECOND)
    assert client.detail == UNANSWERED
    assert not client.refused


def test_raw_pose_has_w_first_and_the_servers_ticks(make_server):
    client, server = make_connected(make_server)
    data = make_frame(server, mid_exposure_ticks=100, transmit_ticks=200)
    (raw,) = client.on_datagram(data, 7, IP, "data")
    assert raw.quaternion == pytest.approx((0.9, 0.1, 0.2, 0.3))
    assert (raw.source_ticks, raw.transmit_ticks, raw.t_arrival_ns, raw.frame) == (100, 200, 7, 9)
    assert raw.live


def test_cameras_that_do_not_stamp_exposure(make_server):
    client, server = make_connected(make_server)
    (raw,) = client.on_datagram(make_frame(server, transmit_ticks=200), 7, IP, "data")
    assert raw.source_ticks == 200
    (raw,) = client.on_datagram(make_frame(server), 7, IP, "data")
    assert raw.source_ticks is None


@pytest.mark.parametrize("goodbye", [natnet.Bare.DISCONNECT, natnet.Bare.DISCONNECT_BY_TIMEOUT])
def test_a_server_that_says_goodbye_is_called_again(make_server, goodbye):
    client, _ = make_connected(make_server)
    client.on_datagram(natnet.encode(goodbye), 10, IP)
    assert not client.connected
    sent = [natnet.decode(d, (4, 1)) for d in client.on_timer(SECOND)]
    assert natnet.Bare.CONNECT in sent


def test_a_changed_bitstream_asks_who_is_there(make_server):
    client, server = make_connected(make_server)
    client.on_datagram(make_frame(server, params=BITSTREAM_CHANGED), 10, IP, "data")
    assert not client.connected
    server.version = (3, 0)
    reply = natnet.encode(server.info(), (3, 0))
    client.on_datagram(reply, 11, IP)
    assert client.info == server.info()
    assert len(client.on_datagram(make_frame(server), 12, IP, "data")) == 1


def test_frames_of_another_version_ask_who_is_there(make_server):
    client, server = make_connected(make_server)
    server.version = (3, 0)
    for i in range(10):
        assert client.on_datagram(make_frame(server), 10 + i, IP, "data") == []
    assert not client.connected
    assert "do not decode" in client.detail
    assert client.counts["malformed"] == 10


def test_an_echo_counts_once_and_only_if_requested(make_server):
    client, _ = make_connected(make_server)
    sent = [natnet.decode(d, (4, 1)) for d in client.on_timer(50 * MS)]
    (echo,) = [m for m in sent if isinstance(m, natnet.EchoRequest)]
    reply = natnet.encode(natnet.EchoResponse(echo.client_stamp, 77))
    measured: list[tuple[int, ...]] = []
    client.ingest.timing.echo.add = lambda *times: measured.append(times)
    client.on_datagram(reply, 60 * MS, IP)
    client.on_datagram(reply, 61 * MS, IP)
    client.on_datagram(natnet.encode(natnet.EchoResponse(123, 77)), 62 * MS, IP)
    assert measured == [(50 * MS, 60 * MS, 77)]


def test_only_frames_count_on_the_data_socket(make_server):
    client, _ = make_connected(make_server)
    forged = natnet.encode(natnet.ModelDef((natnet.RigidBodyDesc("car", 9),)), (4, 1))
    assert client.on_datagram(forged, 10, IP, "data") == []
    assert client.detail == "following 'car' (id 1)"


def test_frame_rate_is_requested_until_it_is_answered(make_server):
    client = NatNetSource("car", IP, IngestConfig())
    server = make_server()
    client.on_datagram(natnet.encode(server.info()), 0, IP)
    answer = natnet.encode(natnet.Response(b"\0\0\xf0\x42"))
    client.on_datagram(answer, 1, IP)
    assert client.status().expected_rate_hz == 120.0
    client.on_datagram(answer, 2, IP)
    assert client.counts["unexpected"] == 1


def test_two_bodies_with_our_id_in_one_frame_are_refused(make_server):
    client, server = make_connected(make_server)
    body = RigidBody(1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    data = natnet.encode(Frame(1, (body, body)), server.version)
    client.on_datagram(data, 5, IP, "data")
    assert client.refused == "2 bodies stream with id 1"


def test_messages_from_the_server_are_passed_on(make_server):
    client, _ = make_connected(make_server)
    client.on_datagram(natnet.encode(natnet.MessageString("licence expired")), 5, IP)
    assert client.detail == "server: licence expired"


def test_forced_transport_goes_before_the_servers_word(make_server):
    info = natnet.encode(make_server(multicast=True).info())
    for forced, expected in ((None, False), (True, True), (False, False)):
        client = NatNetSource("car", IP, IngestConfig(), unicast=forced)
        client.on_datagram(info, 0, IP)
        assert client.unicast is expected
