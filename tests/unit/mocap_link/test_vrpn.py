"""VRPN bytes against vectors written out by hand from the protocol's description."""

import pytest

from steerd.mocap_link import vrpn
from steerd.mocap_link.vrpn_client import VrpnClient
from steerd.sim_hw.mocap.vrpn_device import VrpnServer


def test_cookie() -> None:
    cookie = b"vrpn: ver. 07.38  0\0\0\0\0\0"
    assert vrpn.encode_cookie() == cookie
    assert vrpn.check_cookie(cookie) == "07.38"
    assert vrpn.check_cookie(b"vrpn: ver. 07.36  0\0\0\0\0\0") == "07.36"
    for bad in (b"vrpn: ver. 08.00  0\0\0\0\0\0", cookie[:23], b""):
        with pytest.raises(vrpn.VrpnError):
            vrpn.check_cookie(bad)


def test_description_by_hand() -> None:
    data = vrpn.encode(vrpn.make_description(vrpn.SENDER_DESCRIPTION, 2, "car"))
    by_hand = (
        "00000020"  # 24 + 8: length without padding
        "00000000" "00000000"  # sec, usec
        "00000002"  # the id that is described
        "ffffffff"  # type -1
        "00000000"
        "00000004" "63617200"
    )  # fmt: skip
    assert data.hex() == by_hand.replace(" ", "")


def test_pose_by_hand() -> None:
    payload = vrpn.write_pose(1, ((1.0, 2.0, -0.5), (0.0, 0.0, 0.0, 1.0)))
    assert payload.hex() == (
        "0000000100000000"
        "3ff00000000000004000000000000000bfe0000000000000"
        "0000000000000000000000000000000000000000000000003ff0000000000000"
    )
    assert vrpn.read_pose(payload) == (1, ((1.0, 2.0, -0.5), (0.0, 0.0, 0.0, 1.0)))
    with pytest.raises(vrpn.VrpnError):
        vrpn.read_pose(payload[:-1])


def test_length_excludes_the_padding() -> None:
    data = vrpn.encode(vrpn.Message(1, 0, payload=b"abc"))
    assert len(data) == 32
    assert int.from_bytes(data[:4], "big") == 27
    messages, used = vrpn.decode_stream(data + data)
    assert (len(messages), used) == (2, 64)


@pytest.mark.parametrize("length", [0, 23, -1, 65_537])
def test_impossible_lengths_end_the_stream(length: int) -> None:
    data = length.to_bytes(4, "big", signed=True) + bytes(20)
    with pytest.raises(vrpn.VrpnError):
        vrpn.decode_stream(data)


@pytest.mark.parametrize("payload", [b"", b"\0\0\0", b"\0\0\0\x05abc", b"\xff\xff\xff\xffabc"])
def test_short_descriptions_are_refused(payload: bytes) -> None:
    with pytest.raises(vrpn.VrpnError):
        vrpn.read_description(payload)


def make_pair() -> tuple[VrpnClient, VrpnServer]:
    client, server = VrpnClient("car"), VrpnServer(("car", "b2"))
    assert server.receive(client.hello(), 0) == b""
    assert client.on_bytes(server.hello(), 0) == []
    return client, server


def test_session_greets_maps_ids_and_answers_pings() -> None:
    client, server = make_pair()
    assert client.on_bytes(server.pose("b2", 5, (1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0)), 7) == []
    (raw,) = client.on_bytes(
        server.pose("car", 2_500_000, (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5)), 7
    )
    assert (raw.source_ticks, raw.position) == (2_500_000, (1.0, 2.0, 3.0))
    (pong,), _ = vrpn.decode_stream(server.receive(client.on_timer(10), 9))
    assert (pong.stamp_us, pong.payload) == (9, b"")


def test_quaternion_order_changes_at_the_wire() -> None:
    client, server = make_pair()
    q = (0.9, 0.1, 0.2, 0.3)
    (raw,) = client.on_bytes(server.pose("car", 1, (0.0, 0.0, 0.0), q), 7)
    assert raw.quaternion == q


def test_other_sensors_and_bad_payloads_are_counted() -> None:
    client, _ = make_pair()
    other = vrpn.write_pose(3, ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)))
    for payload in (other, other[:40]):
        assert client.on_bytes(vrpn.encode(vrpn.Message(0, 0, payload=payload)), 1) == []
    assert client.counts["other_sensor"] == 1
    assert client.counts["malformed"] == 1
    assert client.dead is None


def test_goodbye_ends_the_session() -> None:
    client, server = make_pair()
    client.on_bytes(vrpn.encode(vrpn.Message(vrpn.DISCONNECT, 0)), 1)
    assert client.dead == "the server ended the session"
    assert client.on_bytes(server.pose("car", 1, (1.0,) * 3, (1.0, 0.0, 0.0, 0.0)), 2) == []
    assert client.on_timer(3) == b""


def test_the_server_refuses_strangers() -> None:
    server = VrpnServer(("car",))
    assert server.receive(b"GET /", 0) == b""
    with pytest.raises(vrpn.VrpnError):
        server.receive(b" HTTP/1.1\r\nHost: localhost\r\n\r\n", 0)
